import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mlflow import MlflowClient
from mlflow.entities import Run

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import LabError
from pgdl_lab.running import tracking
from pgdl_lab.running.folders import RUN_ID
from pgdl_lab.running.mlflow_server import EXPERIMENT, connect
from tests.conftest import environment

CONFIG = """
finger: {name: pneunet, material: {c1_mpa: 0.11}, gravity_m_s2: [0.0, -9.81]}
fem: {name: solid}
split: {name: random, points: 20}
model: {name: mlp}
loss: {data: {name: data, weight: 1.0}, boundary: {name: boundary, weight: 2.0}}
seed: 0
"""


def new_folder(parent: Path, name: str = "one") -> Path:
    folder = parent / name
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(CONFIG)
    return folder


def read(root: Path, folder: Path) -> Run:
    return client(root).get_run((folder / RUN_ID).read_text())


def client(root: Path) -> MlflowClient:
    return MlflowClient(f"sqlite:///{root}/mlflow.db")


def test_a_run_holds_parameters_tags_metrics_figures_and_dataset(root: Path) -> None:
    folder = new_folder(root / "runs")
    domain = Domain(np.zeros((3, 2)), np.zeros((1, 3), dtype=np.int64))
    snapshots = Dataset.path(domain, np.ones(2), np.zeros((2, 3, 2)))
    with tracking.tracked_run(folder, None) as run:
        run.log_snapshots(snapshots, root / "runs" / "snapshots" / "x.h5")
        for epoch in range(3):
            run.log_metrics({"raw/data": 1.0 / (1 + epoch)}, step=epoch)
        metrics = {"mse_mm2": {"x": 1.5}, "by_pressure": [{"kpa": 1, "seen": True}, {"kpa": 2.0}], "finger": "pneunet"}
        (folder / "metrics.json").write_text(json.dumps(metrics))
        (folder / "figures").mkdir()
        (folder / "figures" / "field.png").write_bytes(b"png")
    stored = read(root, folder)
    assert stored.info.status == "FINISHED"
    assert stored.info.run_name == "one"
    assert stored.data.params["finger.material.c1_mpa"] == "0.11"
    assert stored.data.params["loss.boundary.weight"] == "2.0"
    assert (stored.data.tags["finger"], stored.data.tags["loss"]) == ("pneunet", "data+boundary")
    assert stored.data.metrics == {"raw/data": pytest.approx(1 / 3), "mse_mm2/x": 1.5, "by_pressure/kpa": 2.0}
    lab = client(root)
    assert [m.step for m in lab.get_metric_history(stored.info.run_id, "raw/data")] == [0, 1, 2]
    assert {file.path for file in lab.list_artifacts(stored.info.run_id)} == {"config.yaml", "metrics.json", "figures"}
    assert stored.info.artifact_uri.startswith((root / "runs" / "artifacts").as_uri())
    (dataset,) = stored.inputs.dataset_inputs
    assert dataset.dataset.name == "snapshots"
    assert "snapshots/x.h5" in dataset.dataset.source


@pytest.mark.parametrize(
    ("error", "status"), [(RuntimeError, "FAILED"), (KeyboardInterrupt, "KILLED"), (SystemExit, "KILLED")]
)
def test_a_run_that_breaks_off_says_so(root: Path, error: type[BaseException], status: str) -> None:
    folder = new_folder(root / "runs")
    with pytest.raises(error), tracking.tracked_run(folder, None) as run:
        run.log_metrics({"loss": 1.0})
        raise error
    stored = read(root, folder)
    assert stored.info.status == status
    assert stored.data.metrics == {"loss": 1.0}


def test_a_resumed_run_goes_on_in_the_same_mlflow_run(root: Path) -> None:
    folder = new_folder(root / "runs")
    for step in range(2):
        with tracking.tracked_run(folder, None) as run:
            run.log_metrics({"loss": 1.0}, step)
            assert read(root, folder).info.status == "RUNNING"
    runs = client(root).search_runs([read(root, folder).info.experiment_id])
    assert len(runs) == 1
    assert len(client(root).get_metric_history(runs[0].info.run_id, "loss")) == 2


def test_a_resumed_run_whose_database_is_gone_gets_a_new_one(root: Path) -> None:
    folder = new_folder(root / "runs")
    (folder / RUN_ID).write_text("0" * 32)
    with tracking.tracked_run(folder, None):
        pass
    assert read(root, folder).info.status == "FINISHED"


def test_jobs_of_a_multirun_share_one_parent(root: Path) -> None:
    sweep = root / "runs" / "sweep"
    for job in "01":
        with tracking.tracked_run(new_folder(sweep, job), sweep):
            pass
    parent = read(root, sweep)
    assert parent.info.status == "RUNNING"
    tracking.end_parent(sweep, "FAILED")
    assert read(root, sweep).info.status == "FAILED"
    jobs = [read(root, sweep / job) for job in "01"]
    assert {job.data.tags["mlflow.parentRunId"] for job in jobs} == {parent.info.run_id}
    assert [job.info.run_name for job in jobs] == ["sweep/0", "sweep/1"]


def test_a_multirun_without_tracked_jobs_has_no_parent(root: Path) -> None:
    tracking.end_parent(root / "runs", "FINISHED")
    assert not (root / "runs" / RUN_ID).exists()


def test_another_database_is_used_where_the_environment_names_one(
    root: Path, migrated_database: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = root / "other.db"
    other.write_bytes(migrated_database.read_bytes())
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{other}")
    monkeypatch.chdir(root)
    folder = new_folder(root / "runs")
    with tracking.tracked_run(folder, None):
        pass
    run_id = (folder / RUN_ID).read_text()
    assert MlflowClient(f"sqlite:///{other}").get_run(run_id).info.status == "FINISHED"


def test_a_run_that_is_forgotten_is_no_longer_listed(root: Path) -> None:
    folder = new_folder(root / "runs")
    with tracking.tracked_run(folder, None):
        pass
    experiment = read(root, folder).info.experiment_id
    assert len(client(root).search_runs([experiment])) == 1
    tracking.forget(folder)
    assert client(root).search_runs([experiment]) == []
    (root / "mlflow.db").unlink()
    (root / "mlflow.db").mkdir()
    tracking.forget(folder)  # which is of no use, but no failure


def test_a_damaged_database_is_one_sentence(root: Path) -> None:
    (root / "mlflow.db").write_bytes(b"no database at all" * 100)
    with pytest.raises(LabError, match=r"mlflow\.db cannot be opened .*MLFLOW_TRACKING_URI"):
        connect()


JOB = """
import sys
from pathlib import Path
from pgdl_lab.running import tracking
sweep, job = Path(sys.argv[1]), sys.argv[2]
with tracking.tracked_run(sweep / job, sweep) as run:
    for step in range(20):
        run.log_metrics({"loss": float(step)}, step)
        run.flush()
"""


def test_processes_that_start_together_share_a_fresh_database(tmp_path: Path) -> None:
    sweep = tmp_path / "runs" / "sweep"
    jobs = ["0", "1", "2"]
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", JOB, str(sweep), new_folder(sweep, job).name], env=environment(tmp_path)
        )
        for job in jobs
    ]
    assert [process.wait() for process in processes] == [0, 0, 0]
    parent = read(tmp_path, sweep)
    for job in jobs:
        run = read(tmp_path, sweep / job)
        assert run.info.status == "FINISHED"
        assert run.data.tags["mlflow.parentRunId"] == parent.info.run_id
        assert len(client(tmp_path).get_metric_history(run.info.run_id, "loss")) == 20
    experiments = client(tmp_path).search_experiments()
    assert sorted(experiment.name for experiment in experiments) == ["Default", EXPERIMENT]
    assert len(client(tmp_path).search_runs([parent.info.experiment_id])) == 1 + len(jobs)


def test_a_machine_without_git_is_tracked_without_a_word(tmp_path: Path) -> None:
    script = (
        "import pgdl_lab.running.mlflow_server\n"
        "from mlflow.tracking.context.registry import resolve_tags as r\nassert r()"
    )
    alone = {**environment(tmp_path), "PATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", script], env=alone, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr
