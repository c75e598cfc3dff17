"""A run comes to its end whatever MLflow does, and what MLflow missed is told later."""

import logging
import socket
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from pgdl_lab.core.errors import LabError
from pgdl_lab.running import folders, mlflow_server, outbox, tracking
from tests.test_tracking import client, new_folder, read


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process of its own, and impatient."""
    monkeypatch.setattr(outbox, "_failed_s", -outbox.QUIET_S)
    monkeypatch.setattr(outbox, "_warned", set())
    monkeypatch.setattr(mlflow_server, "LOCKED_S", 0.1)
    monkeypatch.setattr(tracking, "FLUSH_S", -1.0)


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """As while another program writes to the database, or holds it."""
    with closing(sqlite3.connect(root / "mlflow.db", isolation_level=None)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        yield


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize("begins", ["free", "locked"])
def test_a_database_that_is_locked_costs_one_warning_and_nothing_is_lost(
    begins: str, root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = new_folder(root / "runs")
    if begins == "free":
        with tracking.tracked_run(folder, None) as run:
            run.log_metrics({"loss": 2.0}, step=0)
    with locked(root), tracking.tracked_run(folder, None) as run:
        for step in (1, 2, 3):
            run.log_metrics({"loss": 1.0 / step}, step=step)
        (folder / "surrogate.pt").write_bytes(b"the product")
        (folder / "metrics.json").write_text('{"mse_mm2": 0.5}')
    (told,) = warnings(caplog)
    assert "database is locked" in told and "python -m pgdl_lab task=log run=runs/one" in told
    assert tracking.log_again(folder) == 1
    stored = read(root, folder)
    assert stored.info.status == "FINISHED" and stored.data.metrics["mse_mm2"] == 0.5
    steps = [each.step for each in client(root).get_metric_history(stored.info.run_id, "loss")]
    assert steps == [0, 1, 2, 3][begins == "locked" :]
    assert {file.path for file in client(root).list_artifacts(stored.info.run_id)} >= {"surrogate.pt", "metrics.json"}
    assert len(client(root).search_runs([stored.info.experiment_id])) == 1
    assert tracking.log_again(folder) == 0


def test_what_was_missed_is_told_at_the_end_where_mlflow_answers_again(
    root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = new_folder(root / "runs")
    with tracking.tracked_run(folder, None) as run:
        with locked(root):
            run.log_metrics({"loss": 1.0})
        run.log_metrics({"loss": 0.5}, step=1)
    assert len(warnings(caplog)) == 1
    assert not (folder / folders.MISSED).exists()
    assert read(root, folder).data.metrics == {"loss": 0.5} and read(root, folder).info.status == "FINISHED"


def test_a_server_that_is_down_costs_seconds(
    root: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        port = listener.getsockname()[1]  # that nobody listens on any more
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{port}")
    folder, start = new_folder(root / "runs"), time.monotonic()
    with tracking.tracked_run(folder, None) as run:
        run.log_metrics({"loss": 1.0})
    assert time.monotonic() - start < 20  # with MLflow's own settings it is more than four minutes
    (told,) = warnings(caplog)
    assert "Connection refused" in told and "start it" in told
    monkeypatch.delenv("MLFLOW_TRACKING_URI")
    assert tracking.log_again(folder) == 1
    assert read(root, folder).data.metrics == {"loss": 1.0}


def test_jobs_of_a_multirun_are_told_later_in_one_go(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    sweep = root / "runs" / "sweep"
    with locked(root):
        for job in ("0", "1"):
            with tracking.tracked_run(new_folder(sweep, job), sweep):
                pass
        tracking.note_job(sweep / "2", sweep, "FAILED", {"error": "It burst."}, {}, ["seed=3"])
        tracking.end_parent(sweep, "FAILED")
    (told,) = warnings(caplog)
    assert "task=log run=runs/sweep" in told
    assert tracking.log_again(sweep) == 4
    parent = read(root, sweep)
    for job, status in (("0", "FINISHED"), ("1", "FINISHED"), ("2", "FAILED")):
        stored = read(root, sweep / job)
        assert (stored.info.status, stored.data.tags["mlflow.parentRunId"]) == (status, parent.info.run_id)
    assert read(root, sweep / "2").data.params == {"seed": "3"}
    assert parent.info.status == "FAILED"
    assert len(client(root).search_runs([parent.info.experiment_id])) == 4


def test_a_line_that_a_kill_cut_off_is_left_out(root: Path) -> None:
    folder = new_folder(root / "runs")
    with locked(root):
        outbox.send(folder, outbox.Message(tags={"a": "1"}))
    with (folder / folders.MISSED).open("a") as file:
        file.write('\n{"params": {}, "ta')
    outbox.send(folder, outbox.Message(status="KILLED"))
    assert tracking.log_again(folder) == 1
    stored = read(root, folder)
    assert (stored.data.tags["a"], stored.info.status) == ("1", "KILLED")


def test_logging_again_says_when_it_cannot(root: Path) -> None:
    folder = new_folder(root / "runs")
    with locked(root):
        outbox.send(folder, outbox.Message(status="RUNNING"))
        with pytest.raises(LabError, match=r"mlflow\.db cannot be opened \(database is locked\): free it"):
            tracking.log_again(folder)
    assert (folder / folders.MISSED).exists()


def test_a_run_whose_database_was_deleted_is_logged_again(root: Path, migrated_database: Path) -> None:
    folder = new_folder(root / "runs")
    with tracking.tracked_run(folder, None):
        (folder / "metrics.json").write_text('{"mse_mm2": 0.5}')
    (root / "mlflow.db").write_bytes(migrated_database.read_bytes())
    assert tracking.log_again(folder) == 1
    assert read(root, folder).data.metrics == {"mse_mm2": 0.5}


@pytest.mark.parametrize("name", ["o'n", "p%20q", "q?r#s", "ä b", 'd"q', "a;b&c=d"])
def test_any_path_can_hold_the_database_and_the_runs(
    name: str, root: Path, migrated_database: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pgdl_lab.core import paths

    home = root / name
    folder = new_folder(home / "runs", name)
    (home / "mlflow.db").write_bytes(migrated_database.read_bytes())
    monkeypatch.setattr(paths, "ROOT", home)
    monkeypatch.setattr(paths, "RUNS", home / "runs")
    with tracking.tracked_run(folder, None):
        (folder / "metrics.json").write_text('{"mse_mm2": 0.5}')
    lab, experiment = mlflow_server.connect()
    (stored,) = lab.search_runs([experiment])
    assert (stored.info.status, stored.data.tags["folder"]) == ("FINISHED", str(folder))
    assert {file.path for file in lab.list_artifacts(stored.info.run_id)} == {"config.yaml", "metrics.json"}
    assert (home / "runs" / "artifacts" / stored.info.run_id / "artifacts" / "metrics.json").is_file()
    assert {path.name for path in root.iterdir()} == {name, "mlflow.db", "runs"}  # nothing beside it
    lab.update_run(stored.info.run_id, status="RUNNING")
    (folder / folders.RUN_ID).unlink()
    tracking.close_killed(folder)
    assert lab.get_run(stored.info.run_id).info.status == "KILLED"
