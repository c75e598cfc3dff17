"""A finished run of a short finger."""

import os
import shutil
from pathlib import Path

import pytest

from tests.conftest import subprocess_of


@pytest.fixture(scope="session")
def small_training(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root with one finished training."""
    root = tmp_path_factory.mktemp("root")
    done = subprocess_of(
        root, "experiment=small", "model=pod", "yardstick=null", "fem.edge_mm=6", "fem.element=hex20",
        "observation.points=800", "observation.snapshots=5", "model.degree=3", "model.rounds=1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return root


@pytest.fixture
def small_run(small_training: Path, tmp_path: Path) -> Path:
    """The folder of that training, copied to the root of the test."""
    shutil.copytree(small_training, tmp_path, symlinks=True, dirs_exist_ok=True)
    return Path(os.path.realpath(tmp_path / "runs" / "latest"))
