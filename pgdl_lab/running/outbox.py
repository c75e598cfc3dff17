"""What MLflow is told: at once where it answers, and later what it missed, so that no run waits for it or dies of it.

What it missed lies in the folder of its run, in the order in which it was said; `task=log` tells it.
"""

import json
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from filelock import FileLock

from pgdl_lab.core import paths
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.heard import ASIDE
from pgdl_lab.running.folders import MISSED
from pgdl_lab.running.messages import command
from pgdl_lab.running.mlflow_server import LONGEST, connect, gist, log_params, place, run_of

QUIET_S = 60.0  # for which nothing is tried after a failure
BATCH = 1000  # MLflow's limit for one call
ENDED = ("FINISHED", "FAILED", "KILLED")

_log = logging.getLogger(__name__)
_tracebacks = logging.getLogger("pgdl_lab.failure")  # goes to run.log only
_failed_s = -QUIET_S  # when MLflow failed last, on the monotonic clock
_warned: set[Path] = set()  # runs and multiruns of this process whose user knows that MLflow misses something


@dataclass(frozen=True)
class Message:
    """Something about one run; told twice, it does no harm.

    Attributes
    ----------
    params, tags
        Names and values.
    metrics
        Name, value, time since 1970 [ms] and step of each.
    dataset
        Fields of an MLflow dataset.
    files
        Files and folders, and the folder among the artifacts that each is put into.
    status
        "RUNNING" or one of `ENDED`; nothing: as it was.
    parent
        Folder of the multirun that the run belongs to.
    """

    params: Mapping[str, str] = field(default_factory=dict)
    tags: Mapping[str, str] = field(default_factory=dict)
    metrics: Sequence[tuple[str, float, int, int]] = ()
    dataset: Mapping[str, str] | None = None
    files: Sequence[tuple[str, str | None]] = ()
    status: str = ""
    parent: str | None = None


def send(folder: Path, message: Message) -> None:
    """Tell MLflow something about the run of `folder`, or keep it there for later."""
    if time.monotonic() - _failed_s < QUIET_S or (folder / MISSED).exists():
        _keep(folder, message)
        return
    try:
        tell(folder, [message])
    except Exception as error:  # a server, a database, a disk: each has errors of its own, and none is worth a run
        _keep(folder, message)
        _warn(Path(message.parent or folder), error)


def deliver(folder: Path) -> None:
    """Tell MLflow what it missed about the run of `folder`.

    Raises
    ------
    Exception
        Whatever MLflow raises; then all is kept.
    """
    with FileLock(paths.RUNS / ".mlflow_missed.lock"):  # nobody adds meanwhile
        if (folder / MISSED).exists():
            tell(folder, list(_kept(folder / MISSED)))
            (folder / MISSED).unlink()


def settle(folder: Path) -> None:
    """Try once more, at the end of a run or multirun, whether MLflow answers."""
    for each in missed(folder):
        try:
            deliver(each)
        except Exception as error:  # see `send`
            _warn(folder, error)
            return
        _warned.discard(folder)
        _log.info("MLflow answers again and has all of %s.", each)


def missed(folder: Path) -> list[Path]:
    """Folders at and below `folder` about whose runs MLflow missed something, that of a multirun before its jobs."""
    return sorted(path.parent for path in folder.rglob(MISSED))


def _keep(folder: Path, message: Message) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(paths.RUNS / ".mlflow_missed.lock"), (folder / MISSED).open("a", encoding="utf-8") as file:
            file.write("\n" + json.dumps(asdict(message)))
    except OSError as error:
        _log.warning("What MLflow missed cannot be kept in %s: %s.", folder, error.strerror, extra=ASIDE)


def _kept(file: Path) -> Iterator[Message]:
    """What was kept; a line that was cut off by a kill or a full disk is left out."""
    for line in file.read_text(encoding="utf-8").splitlines():
        with suppress(ValueError):
            yield Message(**json.loads(line))


def _warn(folder: Path, error: Exception) -> None:
    """Tell the first failure, and how to make up for it."""
    global _failed_s
    _failed_s = time.monotonic()
    _tracebacks.info("MLflow failed", exc_info=error)
    if folder not in _warned:
        _warned.add(folder)
        reason = str(error) if isinstance(error, LabError) else f"{place()} failed: {gist(error)}."
        run = folder.relative_to(paths.ROOT) if folder.is_relative_to(paths.ROOT) else folder
        _log.warning(
            "MLflow misses what is told from here on. %s The work goes on, and this logs it later: %s",
            reason,
            command("task=log", run=run),
            extra=ASIDE,
        )


def tell(folder: Path, messages: Sequence[Message]) -> None:
    """Tell MLflow something about the run of `folder`, which is made if there is none.

    Raises
    ------
    Exception
        Whatever MLflow raises.
    """
    from mlflow.entities import Dataset, DatasetInput, InputTag, Metric

    client, experiment_id = connect()
    parent = next((Path(message.parent) for message in messages if message.parent), None)
    run_id = run_of(client, experiment_id, folder, parent)
    for message in messages:
        if message.params:
            log_params(client, run_id, message.params)
        for key, value in message.tags.items():
            client.set_tag(run_id, key, value[:LONGEST])
        metrics = [Metric(*metric) for metric in message.metrics]
        for start in range(0, len(metrics), BATCH):
            client.log_batch(run_id, metrics=metrics[start : start + BATCH])
        if message.dataset:
            tags = [InputTag("mlflow.data.context", "training")]
            client.log_inputs(run_id, [DatasetInput(Dataset(**message.dataset), tags)])
        for name, under in message.files:
            if Path(name).is_dir():
                client.log_artifacts(run_id, name, under)
            elif Path(name).exists():
                client.log_artifact(run_id, name, under)
        if message.status in ENDED:
            client.set_terminated(run_id, message.status)
        elif message.status:
            client.update_run(run_id, status=message.status)
