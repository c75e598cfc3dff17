"""Run folders: where a new run writes, and the links to the newest."""

import logging
import os
import re
import secrets
import shutil
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from pgdl_lab.core import paths
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.heard import ASIDE
from pgdl_lab.running.hydra_versions import register_resolver
from pgdl_lab.running.sweep import OVERRIDES

if TYPE_CHECKING:
    from pgdl_lab.surrogate.surrogate import Surrogate

_log = logging.getLogger(__name__)

LATEST, UNFINISHED = "latest", "unfinished"
"""Links in `runs/`: the newest training that ended well, and the run begun last, while it has not come to its end."""
TAKEN = (LATEST, UNFINISHED, "snapshots", "artifacts", "best", "chart", "stability")
"""Names in `runs/` that no study can have."""

RUN_ID, MISSED = "mlflow_run_id", "mlflow_missed.jsonl"
"""Files in the folder of a run or multirun: the id of its MLflow run, and what MLflow is to be told yet."""
OF_EVERY_RUN = {"run.log", "config.yaml", RUN_ID, MISSED}
"""What lies in the folder of a run that has made nothing yet."""

BEST = paths.BEST / "experiment"
"""The best configurations of searches: `<study>/<name>.yaml` there is typed as `experiment=<study>/<name>`."""


def run_folder(resume: str | None, run: str | None) -> str:
    """Folder of a run, new names from the time and a random ending, as runs may start together.

    Parameters
    ----------
    resume, run
        An earlier run that is gone on with or worked on: its folder is the one. `resume=runs/latest` goes on with the
        newest, ended or not.

    Raises
    ------
    InputError
        If nothing can be written there, or there is no such run.
    """
    earlier = _resumed(resume) if resume is not None else run and stored_run(run, multirun=True)
    if earlier:
        _check_writable(earlier)
        return str(earlier)
    _check_writable(paths.RUNS)
    return str(paths.RUNS / f"{time.strftime('%Y-%m-%d_%H-%M-%S')}_{secrets.token_hex(3)}")


# The cache makes all jobs of a multirun share one folder.
register_resolver("run_folder", run_folder, use_cache=True)


def study_folder(study: str) -> str:
    """Folder of a search, the same for all who name the study.

    Raises
    ------
    InputError
        If it cannot be the name of a folder, or nothing can be written there.
    """
    check_study(study)
    folder = paths.RUNS / study
    _check_writable(folder)
    return str(folder)


register_resolver("study_folder", study_folder, use_cache=True)


def check_study(study: str) -> None:
    """Refuse what cannot be the name of a folder in `runs/`; raises InputError."""
    if not re.fullmatch(r"\w[\w.-]*", study) or study in TAKEN:
        raise InputError(
            f"hydra.sweeper.study is '{study}', which names the folder runs/<study>: use letters, digits, '_', '-' and "
            "'.', a letter or digit first, but no name that the lab uses itself."
        )


def _resumed(name: str) -> Path:
    """The run that is gone on with: for `runs/latest` the newest, whether it came to its end or not."""
    unfinished, latest = paths.RUNS / UNFINISHED, paths.RUNS / LATEST
    if latest in (Path(name).absolute(), paths.ROOT / name) and (unfinished / "config.yaml").is_file():
        return unfinished.resolve()
    return stored_run(name)


def stored_run(name: str, multirun: bool = False) -> Path:
    """Folder of an earlier run, or `multirun`, given relative to the working directory or to the root.

    Raises
    ------
    InputError
        If it holds no `config.yaml`.
    """
    for folder in (Path(name), paths.ROOT / name):
        if (folder / "config.yaml").is_file() or (multirun and any(folder.glob(f"*/{OVERRIDES}"))):
            return folder.resolve()
    if (paths.ROOT / name) == paths.RUNS / LATEST:
        raise InputError(f"There is no run in '{name}', as no training has come to its end: train, or name a run.")
    raise InputError(f"There is no run in '{name}': give a folder that holds a config.yaml, for example runs/latest.")


def stored_surrogate(folder: Path) -> "Surrogate":
    """The surrogate of an earlier run, which answers every question without a warning.

    Raises
    ------
    InputError
        If it holds none.
    """
    from pgdl_lab.surrogate.loading import load

    path = folder / "surrogate.pt"
    if not path.is_file():
        raise InputError(f"{folder} holds no surrogate.pt: give the folder of a training, run=runs/<its name>.")
    return load(path, outside="ignore")


def _check_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"Nothing can be written to {folder} ({error.strerror}): make it a folder that you may write to, "
            "or set PGDL_LAB_ROOT to another place."
        ) from error


def begin(folder: Path) -> None:
    """Let `runs/unfinished` point to a run that begins."""
    _link(UNFINISHED, folder)


def end(folder: Path) -> None:
    """Note that a run came to its end: `runs/latest` points to it if it holds what tasks work on."""
    if (folder / "surrogate.pt").is_file() and (folder / "metrics.json").is_file():
        _link(LATEST, folder)
    _forget(folder)


def is_empty(folder: Path) -> bool:
    """Whether a run has made nothing yet."""
    return {path.name for path in folder.iterdir()} <= OF_EVERY_RUN


def discard(folder: Path) -> None:
    """Remove the folder of a run that was refused before it made anything."""
    _forget(folder)
    shutil.rmtree(folder)


def _forget(folder: Path) -> None:
    """Take away `runs/unfinished` if it points to `folder`."""
    unfinished = paths.RUNS / UNFINISHED
    if unfinished.resolve() == folder.resolve():
        unfinished.unlink(missing_ok=True)


def _link(name: str, folder: Path) -> None:
    """Let `runs/<name>` point to `folder`, in one step, so that a reader never finds it missing."""
    temporary = paths.RUNS / f".{name}.{secrets.token_hex(3)}"
    try:
        temporary.symlink_to(os.path.relpath(folder, paths.RUNS), target_is_directory=True)
        os.replace(temporary, paths.RUNS / name)
    except OSError as error:  # a full disk, or one without links: the run does without
        temporary.unlink(missing_ok=True)
        _log.warning("runs/%s could not be set to %s: %s", name, folder.name, error.strerror, extra=ASIDE)
