"""Tracking in MLflow: one run per training, one parent run per multirun.

The database is `mlflow.db` in the root, where a bare `mlflow ui` finds it, unless MLFLOW_TRACKING_URI says otherwise.
"""

import json
import logging
import os
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock
from omegaconf import OmegaConf

from pgdl_lab import paths
from pgdl_lab.errors import LabError
from pgdl_lab.files import replacing
from pgdl_lab.registry import KINDS
from pgdl_lab.search.trial import TrialPruned
from pgdl_lab.snapshots import Snapshots

os.environ.setdefault("MLFLOW_CONFIGURE_LOGGING", "false")  # its own handlers would print every message twice

from mlflow import MlflowClient  # noqa: E402
from mlflow.entities import DatasetInput, InputTag, Metric, Param, RunTag  # noqa: E402
from mlflow.exceptions import MlflowException  # noqa: E402

EXPERIMENT = "pgdl_lab"
RUN_ID = "mlflow_run_id"
"""File in the folder of a run or multirun with the id of its MLflow run."""

_FLUSH_S = 5.0  # one write per metric would cost more than an epoch of a small network
_BATCH = 1000  # MLflow's limit for one call
_LONGEST = 6000  # characters of a parameter, likewise

for _noisy in ("mlflow", "alembic"):
    logging.getLogger(_noisy).setLevel(logging.WARNING)


class TrackedRun:
    """An open MLflow run.

    Parameters
    ----------
    client
        The connection to the database or server.
    run_id
        The run.
    """

    def __init__(self, client: MlflowClient, run_id: str) -> None:
        self.run_id = run_id
        self._client = client
        self._metrics: list[Metric] = []
        self._flushed = time.monotonic()

    def log_metrics(self, metrics: Mapping[str, float], step: int = 0) -> None:
        """Keep numbers of one epoch; they are written every few seconds and at the end."""
        now = time.time_ns() // 1_000_000
        self._metrics += [Metric(key, float(value), now, step) for key, value in metrics.items()]
        if time.monotonic() - self._flushed > _FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write the numbers that are kept."""
        for start in range(0, len(self._metrics), _BATCH):
            self._client.log_batch(self.run_id, metrics=self._metrics[start : start + _BATCH])
        self._metrics.clear()
        self._flushed = time.monotonic()

    def log_snapshots(self, snapshots: Snapshots, source: Path) -> None:
        """Note the dataset that the run was trained on and the file it lies in."""
        from mlflow.data.numpy_dataset import from_numpy

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MLflow finds two equal readings of a local path
            dataset = from_numpy(snapshots.displacements, source=str(source), name="snapshots")
        entry = DatasetInput(dataset._to_mlflow_entity(), [InputTag("mlflow.data.context", "training")])
        self._client.log_inputs(self.run_id, [entry])

    def log_results(self, folder: Path) -> None:
        """Copy what the run wrote into its folder: configuration, metrics (as numbers too), figures and surrogate."""
        metrics = folder / "metrics.json"
        if metrics.is_file():
            for key, step, value in _numbers(json.loads(metrics.read_text(encoding="utf-8"))):
                self.log_metrics({key: value}, step)
        for name in ("config.yaml", "metrics.json", "surrogate.pt"):
            if (folder / name).is_file():
                self._client.log_artifact(self.run_id, str(folder / name))
        if (folder / "figures").is_dir():
            self._client.log_artifacts(self.run_id, str(folder / "figures"), "figures")


@contextmanager
def tracked_run(folder: Path, sweep_folder: Path | None) -> Iterator[TrackedRun]:
    """Open the MLflow run of a run folder: a new one, or the old one where the folder is resumed.

    Ends as FINISHED, as FAILED after an exception, or as KILLED after an interrupt or where a search prunes it.

    Parameters
    ----------
    folder
        The run folder; its `config.yaml` gives the parameters.
    sweep_folder
        The folder of the multirun that it belongs to, or None.

    Raises
    ------
    LabError
        If the database or server cannot be opened.
    """
    client, experiment_id = _connect()
    run_id = _known_run(client, folder)
    if run_id is None:
        tags = {"mlflow.parentRunId": _parent(client, experiment_id, sweep_folder)} if sweep_folder else {}
        run_id = _new_run(client, experiment_id, folder, tags)
        _log_config(client, run_id, folder)
    client.update_run(run_id, status="RUNNING")
    run = TrackedRun(client, run_id)
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
        run.log_results(folder)
        run.flush()
        client.set_terminated(run_id, status)


def add_artifacts(folder: Path, made: Iterable[Path]) -> None:
    """Copy files and folders that were made of a finished run to its MLflow run, if that is still there."""
    if (folder / RUN_ID).is_file():
        client, _ = _connect()
        run_id = _known_run(client, folder)
        for path in made:
            if run_id is None:
                return
            if path.is_dir():
                client.log_artifacts(run_id, str(path), path.name)
            else:
                client.log_artifact(run_id, str(path))


def open_parent(sweep_folder: Path, params: Mapping[str, str]) -> None:
    """Open the parent run of a search, a new one or the old one where the search goes on."""
    client, experiment_id = _connect()
    parent = _parent(client, experiment_id, sweep_folder)
    client.update_run(parent, status="RUNNING")
    client.log_batch(parent, params=[Param(key, value[:_LONGEST]) for key, value in params.items()])


def end_parent(sweep_folder: Path, status: str) -> None:
    """Close the parent run of a multirun, if any of its jobs was tracked."""
    if (sweep_folder / RUN_ID).is_file():
        client, _ = _connect()
        parent = _known_run(client, sweep_folder)
        if parent is not None:
            client.set_terminated(parent, status)


def log_to_parent(sweep_folder: Path, files: Iterable[Path]) -> None:
    """Copy files of a multirun to its parent run; figures under `figures`, as in other runs."""
    client, experiment_id = _connect()
    parent = _parent(client, experiment_id, sweep_folder)
    for file in files:
        client.log_artifact(parent, str(file), "figures" if file.suffix == ".png" else None)


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
    client, experiment_id = _connect()
    run_id = _known_run(client, folder)
    if run_id is None:
        folder.mkdir(parents=True, exist_ok=True)
        parent = _parent(client, experiment_id, sweep_folder)
        run_id = _new_run(client, experiment_id, folder, {"mlflow.parentRunId": parent})
        typed = (override.partition("=") for override in overrides)
        client.log_batch(run_id, params=[Param(key.lstrip("+"), value) for key, _, value in typed])
        run = TrackedRun(client, run_id)
        run.log_results(folder)
        run.flush()
    now = time.time_ns() // 1_000_000
    client.log_batch(
        run_id,
        metrics=[Metric(f"objective/{key.replace('+', ' ')}", value, now, 0) for key, value in metrics.items()],
        tags=[RunTag(key, value) for key, value in tags.items()],
    )
    client.set_terminated(run_id, status)


def close_killed(folder: Path) -> None:
    """End the run of a trial whose process was killed, if it had one; its folder has the trial's number for a name."""
    client, experiment_id = _connect()
    # By its tag: killed as it was made, it has left no file with its number.
    for run in client.search_runs([experiment_id], f"tags.folder = '{folder}'"):
        client.set_tag(run.info.run_id, "trial", folder.name)
        client.set_tag(run.info.run_id, "trial_state", "killed")
        client.set_terminated(run.info.run_id, "KILLED")


def _connect() -> tuple[MlflowClient, str]:
    """Client and experiment; both the database and the experiment are made under a lock, as jobs may start at once."""
    uri = os.environ.get("MLFLOW_TRACKING_URI")
    artifacts = None if uri else (paths.RUNS / "artifacts").as_uri()
    try:
        with FileLock(paths.RUNS / ".mlflow.lock"):
            client = MlflowClient(uri or f"sqlite:///{paths.ROOT / 'mlflow.db'}")
            experiment = client.get_experiment_by_name(EXPERIMENT)
            if experiment is not None:
                return client, experiment.experiment_id
            return client, client.create_experiment(EXPERIMENT, artifact_location=artifacts)
    except Exception as error:  # a database, a server or a file: each has errors of its own
        place = uri or paths.ROOT / "mlflow.db"
        reason = str(error).splitlines()[0]
        raise LabError(
            f"The tracking database {place} cannot be opened ({reason}): "
            "mend or move it away, or set MLFLOW_TRACKING_URI to another."
        ) from error


def _parent(client: MlflowClient, experiment_id: str, sweep_folder: Path) -> str:
    """Run of the whole multirun: the job that comes first makes it, in whichever process."""
    with FileLock(sweep_folder / ".mlflow.lock"):
        return _known_run(client, sweep_folder) or _new_run(client, experiment_id, sweep_folder, {})


def _known_run(client: MlflowClient, folder: Path) -> str | None:
    file = folder / RUN_ID
    if not file.is_file():
        return None
    run_id = file.read_text(encoding="utf-8").strip()
    try:
        client.get_run(run_id)
    except MlflowException:  # the database was deleted, or is another one now
        return None
    return run_id


def _new_run(client: MlflowClient, experiment_id: str, folder: Path, tags: Mapping[str, str]) -> str:
    from mlflow.tracking.context.registry import resolve_tags  # user, program and git commit

    name = str(folder.relative_to(paths.RUNS)) if folder.is_relative_to(paths.RUNS) else folder.name
    run = client.create_run(experiment_id, run_name=name, tags=resolve_tags({**tags, "folder": str(folder)}))
    run_id: str = run.info.run_id
    with replacing(folder / RUN_ID) as temporary:
        temporary.write_text(run_id, encoding="utf-8")
    return run_id


def _log_config(client: MlflowClient, run_id: str, folder: Path) -> None:
    config: Any = OmegaConf.to_container(OmegaConf.load(folder / "config.yaml"))
    client.log_batch(run_id, params=[Param(key, str(value)) for key, value in _leaves(config)])
    for kind in KINDS:
        choice = config[kind].get("name") or "+".join(config[kind])
        client.set_tag(run_id, kind, choice)


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of a nested mapping."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


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
