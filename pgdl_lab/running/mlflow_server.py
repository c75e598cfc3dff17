"""MLflow's database or server: where it is, whether it answers, and the run of each folder in it.

The database is `mlflow.db` in the root, where a bare `mlflow ui` finds it, unless MLFLOW_TRACKING_URI says otherwise.
"""

import logging
import os
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from filelock import FileLock
from omegaconf import OmegaConf
from sqlalchemy import URL

from pgdl_lab.core import paths
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.registry import KINDS
from pgdl_lab.running.folders import RUN_ID

SETTINGS = {
    "MLFLOW_CONFIGURE_LOGGING": "false",  # its own handlers would print every message twice
    # By itself it tries for four minutes before it gives up; what it misses here is told later.
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
}
for _name, _value in SETTINGS.items():
    os.environ.setdefault(_name, _value)

from mlflow import MlflowClient  # noqa: E402
from mlflow.entities import Param  # noqa: E402
from mlflow.exceptions import MlflowException  # noqa: E402
from mlflow.protos.databricks_pb2 import RESOURCE_DOES_NOT_EXIST, ErrorCode  # noqa: E402

EXPERIMENT = "pgdl_lab"

LOCKED_S = 5.0  # for which a database may be locked, as it is while another run writes
LONGEST = 6000  # characters of a parameter: MLflow's limit

for _noisy in ("mlflow", "alembic"):
    logging.getLogger(_noisy).setLevel(logging.WARNING)
# They tell each try, and what is raised then, which is told here; and that git is not installed, which nobody needs.
for _noisy in ("mlflow.store.db", "urllib3", "mlflow.utils.git_utils"):
    logging.getLogger(_noisy).setLevel(logging.CRITICAL)


def place() -> str:
    """The database or server, to be shown."""
    return os.environ.get("MLFLOW_TRACKING_URI") or str(_database())


def connect() -> tuple[MlflowClient, str]:
    """Client and experiment; both the database and the experiment are made under a lock, as jobs may start at once.

    Raises
    ------
    LabError
        If the database or server cannot be opened.
    """
    uri = os.environ.get("MLFLOW_TRACKING_URI")
    artifacts = None if uri else (paths.RUNS / "artifacts").as_uri()
    try:
        if not uri:
            _wait_for(_database())
            # By this name of the driver MLflow leaves the path alone, of which it would make a folder as it is quoted.
            uri = URL.create("sqlite+pysqlite", database=str(_database())).render_as_string()
        with FileLock(paths.RUNS / ".mlflow.lock"):
            client = MlflowClient(uri)
            experiment = client.get_experiment_by_name(EXPERIMENT)
            if experiment is not None:
                return client, experiment.experiment_id
            return client, client.create_experiment(EXPERIMENT, artifact_location=artifacts)
    except Exception as error:  # a database, a server or a file: each has errors of its own
        remedy = "start it" if uri == place() else "free it, mend it or move it away"
        raise LabError(
            f"The tracking database {place()} cannot be opened ({gist(error)}): {remedy}, or set MLFLOW_TRACKING_URI "
            "to another."
        ) from error


def gist(error: BaseException) -> str:
    """What went wrong at the bottom of an error of MLflow, in one line; around it are names of classes and calls."""
    while (below := error.__cause__ or error.__context__) is not None:
        error = below
    told = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
    return " ".join(told.split()) or type(error).__name__


def _database() -> Path:
    return paths.ROOT / "mlflow.db"


def _wait_for(database: Path) -> None:
    """Wait until nobody else writes; MLflow would wait for minutes."""
    if database.exists():
        with closing(sqlite3.connect(database, timeout=LOCKED_S, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute("ROLLBACK")


def known_run(client: MlflowClient, folder: Path) -> str | None:
    """The run of a folder, None if it has none or the database does not know it."""
    file = folder / RUN_ID
    if not file.is_file():
        return None
    run_id = file.read_text(encoding="utf-8").strip()
    try:
        client.get_run(run_id)
    except MlflowException as error:
        if error.error_code == ErrorCode.Name(RESOURCE_DOES_NOT_EXIST):
            return None  # the database was deleted, or is another one now
        raise
    return run_id


def run_of(client: MlflowClient, experiment_id: str, folder: Path, parent: Path | None) -> str:
    """The run of a folder, made if there is none; `parent` is the folder of the multirun that it belongs to.

    Of a multirun any of its jobs may come first, in whichever process.
    """
    known = known_run(client, folder)
    if known is not None:
        return known
    if parent is not None:
        return _new_run(
            client, experiment_id, folder, {"mlflow.parentRunId": run_of(client, experiment_id, parent, None)}
        )
    if (folder / "config.yaml").is_file():
        return _new_run(client, experiment_id, folder, {})
    with FileLock(folder / ".mlflow.lock"):
        return known_run(client, folder) or _new_run(client, experiment_id, folder, {})


def find_run(folder: Path) -> None:
    """Note the number of the run of a folder whose process was killed before it could."""
    client, experiment_id = connect()
    for run in client.search_runs([experiment_id], "attributes.status = 'RUNNING'"):
        if run.data.tags.get("folder") == str(folder):  # in the filter, quotes in the path would end it
            _note(folder, run.info.run_id)


def _note(folder: Path, run_id: str) -> None:
    with replacing(folder / RUN_ID) as temporary:
        temporary.write_text(run_id, encoding="utf-8")


def _new_run(client: MlflowClient, experiment_id: str, folder: Path, tags: Mapping[str, str]) -> str:
    from mlflow.tracking.context.registry import resolve_tags  # user, program and git commit

    name = str(folder.relative_to(paths.RUNS)) if folder.is_relative_to(paths.RUNS) else folder.name
    run = client.create_run(experiment_id, run_name=name, tags=resolve_tags({**tags, "folder": str(folder)}))
    run_id: str = run.info.run_id
    _note(folder, run_id)
    if (folder / "config.yaml").is_file():
        _log_config(client, run_id, folder)
    return run_id


def _log_config(client: MlflowClient, run_id: str, folder: Path) -> None:
    config: Any = OmegaConf.to_container(OmegaConf.load(folder / "config.yaml"))
    log_params(client, run_id, dict(_leaves(config)))
    for kind in KINDS:
        choice = config[kind].get("name") or "+".join(config[kind])
        client.set_tag(run_id, kind, choice)


def log_params(client: MlflowClient, run_id: str, params: Mapping[str, Any]) -> None:
    """Log parameters, cut to the length that MLflow takes."""
    client.log_batch(run_id, params=[Param(key, str(value)[:LONGEST]) for key, value in params.items()])


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of a nested mapping."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
