"""pgdl_lab: physics-guided surrogates of pneumatic soft fingers."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pgdl_lab.surrogate import Surrogate

try:
    __version__ = version("pgdl_lab")
except PackageNotFoundError:  # run from a checkout that is not installed
    __version__ = "0+checkout"


def load(path: str | Path, outside: str = "warn") -> Surrogate:
    """Read a surrogate file; see `pgdl_lab.deploy.loading.load`."""
    from pgdl_lab.deploy.loading import load  # NumPy is imported only when it is needed

    return load(path, outside)
