"""Run folders: where a new run writes, and the link to the newest."""

import os
import secrets
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import OmegaConf

from pgdl_lab import paths
from pgdl_lab.errors import InputError

if TYPE_CHECKING:
    from pgdl_lab.surrogate import Surrogate

BEST = paths.BEST / "experiment"
"""The best configurations of searches: `<study>/<name>.yaml` there is typed as `experiment=<study>/<name>`."""


def run_folder(resume: str | None, run: str | None) -> str:
    """Folder of a run, new names from the time and a random ending, as runs may start together.

    Parameters
    ----------
    resume, run
        An earlier run that is gone on with or worked on: its folder is the one.

    Raises
    ------
    InputError
        If nothing can be written there, or there is no such run.
    """
    earlier = resume or run
    if earlier is not None:
        folder = stored_run(earlier)
        _check_writable(folder)
        return str(folder)
    _check_writable(paths.RUNS)
    return str(paths.RUNS / f"{time.strftime('%Y-%m-%d_%H-%M-%S')}_{secrets.token_hex(3)}")


# The cache makes all jobs of a multirun share one folder.
OmegaConf.register_new_resolver("run_folder", run_folder, use_cache=True, replace=True)


def study_folder(study: str) -> str:
    """Folder of a search, the same for all who name the study.

    Raises
    ------
    InputError
        If nothing can be written there.
    """
    folder = paths.RUNS / study
    _check_writable(folder)
    return str(folder)


OmegaConf.register_new_resolver("study_folder", study_folder, use_cache=True, replace=True)


def stored_run(name: str) -> Path:
    """Folder of an earlier run, given relative to the working directory or to the root.

    Raises
    ------
    InputError
        If it holds no `config.yaml`.
    """
    for folder in (Path(name), paths.ROOT / name):
        if (folder / "config.yaml").is_file():
            return folder.resolve()
    raise InputError(f"There is no run in '{name}': give a folder that holds a config.yaml, for example runs/latest.")


def stored_surrogate(folder: Path) -> "Surrogate":
    """The surrogate of an earlier run, which answers every question without a warning.

    Raises
    ------
    InputError
        If it holds none.
    """
    from pgdl_lab import load

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


def link_latest(folder: Path) -> None:
    """Let `runs/latest` point to `folder`, in one step, so that a reader never finds it missing."""
    temporary = paths.RUNS / f".latest.{secrets.token_hex(3)}"
    temporary.symlink_to(os.path.relpath(folder, paths.RUNS), target_is_directory=True)
    os.replace(temporary, paths.RUNS / "latest")
