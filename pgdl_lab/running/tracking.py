"""Tracking in MLflow: one run per training, one parent run per multirun. Nothing here fails because MLflow does."""

import json
import logging
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import LabError
from pgdl_lab.running.folders import MISSED, RUN_ID
from pgdl_lab.running.mlflow_server import connect, find_run, gist, known_run, place
from pgdl_lab.running.outbox import Message, deliver, missed, send, settle, tell
from pgdl_lab.running.sweep import OVERRIDES
from pgdl_lab.running.trial import TrialPruned

FLUSH_S = 5.0  # one write per metric would cost more than an epoch of a small network

_log = logging.getLogger(__name__)


class TrackedRun:
    """The MLflow run of a folder.

    Parameters
    ----------
    folder
        The run folder; its `config.yaml` gives the parameters.
    sweep_folder
        The folder of the multirun that it belongs to, or None.
    """

    def __init__(self, folder: Path, sweep_folder: Path | None) -> None:
        self.folder = folder
        self._parent = str(sweep_folder) if sweep_folder else None
        self._metrics: list[tuple[str, float, int, int]] = []
        self._flushed = time.monotonic()

    def log_metrics(self, metrics: Mapping[str, float], step: int = 0) -> None:
        """Keep numbers of one epoch; they are written every few seconds and at the end."""
        self._metrics += _stamped(metrics, time.time(), step)
        if time.monotonic() - self._flushed > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write the numbers that are kept."""
        if self._metrics:
            self.send(Message(metrics=self._metrics))
        self._metrics = []
        self._flushed = time.monotonic()

    def send(self, message: Message) -> None:
        """Tell MLflow."""
        send(self.folder, replace(message, parent=self._parent))

    def log_snapshots(self, snapshots: Dataset, source: Path) -> None:
        """Note the dataset that the run was trained on and the file it lies in."""
        from mlflow.data.numpy_dataset import from_numpy

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MLflow finds two equal readings of a local path
            entity = from_numpy(snapshots.displacements, source=str(source), name="snapshots")._to_mlflow_entity()
        self.send(Message(dataset=dict(entity)))


@contextmanager
def tracked_run(folder: Path, sweep_folder: Path | None) -> Iterator[TrackedRun]:
    """Open the MLflow run of a run folder: a new one, or the old one where the folder is resumed.

    Ends as FINISHED, as FAILED after an exception, or as KILLED after an interrupt or where a search prunes it.

    Parameters
    ----------
    folder, sweep_folder
        See `TrackedRun`.
    """
    run = TrackedRun(folder, sweep_folder)
    run.send(Message(status="RUNNING"))
    status = "KILLED"
    try:
        yield run
        status = "FINISHED"
    except TrialPruned:
        raise
    except Exception:
        status = "FAILED"
        raise
    finally:
        run.flush()
        run.send(_results(folder, status))
        if sweep_folder is None:  # a multirun tries at its own end
            settle(folder)


def _results(folder: Path, status: str) -> Message:
    """What a run wrote into its folder: configuration, metrics (as numbers too), figures and surrogate."""
    metrics, found = folder / "metrics.json", []
    try:
        if metrics.is_file():
            written, numbers = metrics.stat().st_mtime, _numbers(json.loads(metrics.read_text(encoding="utf-8")))
            found = [each for key, step, value in numbers for each in _stamped({key: value}, written, step)]
    except (OSError, ValueError) as error:
        _log.warning("MLflow gets no metrics, as %s cannot be read: %s", metrics, error)
    files = [(str(folder / name), None) for name in ("config.yaml", "metrics.json", "surrogate.pt")]
    return Message(metrics=found, files=[*files, (str(folder / "figures"), "figures")], status=status)


def log_again(folder: Path) -> int:
    """Tell MLflow what it missed or has lost of the run or multirun in `folder`.

    Returns
    -------
    The number of runs that something was told about.

    Raises
    ------
    LabError
        If MLflow does not answer.
    """
    runs = [folder] if (folder / "config.yaml").is_file() else [job.parent for job in folder.glob("*/config.yaml")]
    late = missed(folder)
    try:
        client, _ = connect()
        lost = [each for each in runs if each not in late and known_run(client, each) is None]
        for each in late:
            deliver(each)
        for each in lost:
            parent = str(each.parent) if (each / OVERRIDES).is_file() else None
            status = "FINISHED" if (each / "metrics.json").is_file() else "FAILED"
            tell(each, [replace(_results(each, status), parent=parent)])
    except LabError:
        raise
    except Exception as error:  # a server or a database: each has errors of its own
        raise LabError(f"{place()} failed ({gist(error)}): try again when it works.") from error
    return len({*late, *lost})


def add_artifacts(folder: Path, made: Iterable[Path]) -> None:
    """Copy files and folders that were made of a finished run to its MLflow run, if it has one."""
    if _tracked(folder):
        send(folder, Message(files=[(str(path), path.name if path.is_dir() else None) for path in made]))
        settle(folder)


def open_parent(sweep_folder: Path, params: Mapping[str, str]) -> None:
    """Open the parent run of a search, a new one or the old one where the search goes on."""
    send(sweep_folder, Message(params=params, status="RUNNING"))


def end_parent(sweep_folder: Path, status: str, files: Iterable[Path] = ()) -> None:
    """Close the parent run of a multirun, if any of its jobs was tracked, with files that were made of it."""
    if _tracked(sweep_folder) or missed(sweep_folder):
        log_to_parent(sweep_folder, files)
        send(sweep_folder, Message(status=status))
    settle(sweep_folder)


def log_to_parent(sweep_folder: Path, files: Iterable[Path]) -> None:
    """Copy files of a multirun to its parent run; figures under `figures`, as in other runs."""
    send(sweep_folder, Message(files=[(str(file), "figures" if file.suffix == ".png" else None) for file in files]))


def note_job(
    folder: Path,
    sweep_folder: Path,
    status: str,
    tags: Mapping[str, str],
    metrics: Mapping[str, float],
    overrides: Iterable[str],
) -> None:
    """Mark the run of a multirun's job; a job that its task did not track gets a run now.

    Parameters
    ----------
    folder, sweep_folder
        Folders of the job and of the multirun.
    status
        "FINISHED", "FAILED" or "KILLED".
    tags, metrics
        What is marked.
    overrides
        What was typed for this job, the parameters of a run that has no configuration.
    """
    results = Message()
    if not _tracked(folder):
        folder.mkdir(parents=True, exist_ok=True)
        results = _results(folder, "")
        if not (folder / "config.yaml").is_file():
            typed = (override.partition("=") for override in overrides)
            results = replace(results, params={key.lstrip("+"): value for key, _, value in typed})
    found = {f"objective/{key.replace('+', ' ')}": value for key, value in metrics.items()}
    marked = [*results.metrics, *_stamped(found, time.time(), 0)]
    send(folder, replace(results, tags=tags, metrics=marked, status=status, parent=str(sweep_folder)))


def close_killed(folder: Path) -> None:
    """End the run of a trial whose process was killed, if it had one; its folder has the trial's number for a name."""
    if not _tracked(folder):
        try:
            find_run(folder)
        except Exception as error:  # MLflow does not answer: then it has no run to end either
            _log.debug("No run of %s was found", folder, exc_info=error)
    if _tracked(folder):
        tags = {"trial": folder.name, "trial_state": "killed"}
        send(folder, Message(tags=tags, status="KILLED", parent=str(folder.parent)))


def forget(folder: Path) -> None:
    """Delete the run of a folder that was refused, if it has one."""
    try:
        client, _ = connect()
        if (run_id := known_run(client, folder)) is not None:
            client.delete_run(run_id)
    except Exception as error:  # see `outbox.send`
        _log.debug("The run of %s could not be deleted", folder, exc_info=error)


def _tracked(folder: Path) -> bool:
    """Whether there is, or will be, a run of `folder` in MLflow."""
    return (folder / RUN_ID).is_file() or (folder / MISSED).is_file()


def _stamped(metrics: Mapping[str, float], seconds: float, step: int) -> list[tuple[str, float, int, int]]:
    return [(key, float(value), int(1000 * seconds), step) for key, value in metrics.items()]


def _numbers(value: Any, key: str = "", step: int = 0) -> Iterator[tuple[str, int, float]]:
    """Slashed keys, steps and values of the numbers in a JSON tree; a list becomes the steps of one metric."""
    if isinstance(value, Mapping):
        for name, child in value.items():
            yield from _numbers(child, f"{key}/{name}" if key else name, step)
    elif isinstance(value, list):
        for index, child in enumerate(value):
            yield from _numbers(child, key, index)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, step, float(value)
