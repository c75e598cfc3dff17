"""What some tests need beyond the packages of `.[test]`; they are skipped where it is missing."""

import importlib.util
import os
import shutil
from pathlib import Path

import pytest

DEBIAN = {
    "ccx": "calculix-ccx",
    "chromedriver": "chromium-driver",
    "chromium": "chromium",
    "g++": "g++",
    "initdb": "postgresql",
}
"""Programs, and Debian's packages of them."""

EXTRAS = {
    "hydra_plugins.hydra_ray_launcher": "pgdl_lab[ray]",
    "hydra_plugins.hydra_submitit_launcher": "pgdl_lab[slurm]",
}
"""Modules, and what `pip install` brings them."""

ALL = "PGDL_LAB_TEST_ALL"
"""Set in the environment, it makes a failure of what would be skipped."""


def need(*names: str) -> None:
    """Skip the test that asks for a program or module which is not installed, or fail it where all shall be tested."""
    missing = [_package(name) for name in names if not _found(name)]
    if missing:
        reason = f"not installed: {', '.join(missing)}"
        if os.environ.get(ALL):
            pytest.fail(reason)
        pytest.skip(reason)


def program(name: str) -> str | None:
    """Place of a program; PostgreSQL's are looked for where Debian keeps them off the path too."""
    kept = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(kept[-1]) if kept else shutil.which(name)


def _found(name: str) -> bool:
    return program(name) is not None if name in DEBIAN else importlib.util.find_spec(name) is not None


def _package(name: str) -> str:
    return f"Debian's {DEBIAN[name]}" if name in DEBIAN else EXTRAS[name]
