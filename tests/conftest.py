"""Fixtures shared by all tests. Nothing is ever written into the checkout."""

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

_root = tempfile.mkdtemp(prefix="pgdl_lab_tests_")
atexit.register(shutil.rmtree, _root, ignore_errors=True)
os.environ["PGDL_LAB_ROOT"] = _root  # before anything imports pgdl_lab.core.paths
os.environ.pop("MLFLOW_TRACKING_URI", None)
if "PYTEST_XDIST_WORKER" in os.environ:  # each core has a worker of its own
    os.environ.setdefault("OMP_NUM_THREADS", "1")

if TYPE_CHECKING:
    from omegaconf import DictConfig

CHECKOUT = Path(__file__).resolve().parents[1]
Lab = Callable[..., subprocess.CompletedProcess[str]]


def environment(root: Path) -> dict[str, str]:
    """Environment of a process with a root of its own, which finds this package and `tests`."""
    found = os.pathsep.join(filter(None, [str(CHECKOUT), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PGDL_LAB_ROOT": str(root), "OMP_NUM_THREADS": "1", "PYTHONPATH": found}


def composed(*typed: str) -> "DictConfig":
    """The configuration that the command line makes of what is `typed`."""
    from hydra import compose, initialize_config_dir

    from pgdl_lab.core.paths import CONF
    from pgdl_lab.running.composing import store_choices
    from pgdl_lab.running.hydra_versions import BASE

    store_choices()
    with initialize_config_dir(str(CONF), **BASE):
        return compose("config", list(typed))


@pytest.fixture(scope="session")
def migrated_database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty MLflow database; making the tables takes seconds, so tests copy it."""
    from mlflow import MlflowClient

    path = tmp_path_factory.mktemp("mlflow") / "mlflow.db"
    MlflowClient(f"sqlite:///{path}").search_experiments()
    return path


@pytest.fixture
def root(tmp_path: Path, migrated_database: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A root of its own for what runs inside the test process."""
    from pgdl_lab.core import paths

    shutil.copy(migrated_database, tmp_path / "mlflow.db")
    (tmp_path / "runs").mkdir()
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    monkeypatch.setattr(paths, "RUNS", tmp_path / "runs")
    return tmp_path


def subprocess_of(root: Path, *args: str) -> subprocess.CompletedProcess[str]:
    """`python -m pgdl_lab` with these arguments, in a process and a root of its own."""
    command = [sys.executable, "-m", "pgdl_lab", *args]
    return subprocess.run(command, env=environment(root), cwd=root, capture_output=True, text=True, check=False)


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    """Run `python -m pgdl_lab` with the given arguments in a process and a root of its own."""

    return partial(subprocess_of, tmp_path)
