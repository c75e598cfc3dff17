"""The whole way of the data, with made-up snapshots in place of a simulation."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from mlflow import MlflowClient
from mlflow.entities import Run

import pgdl_lab
from pgdl_lab.core.errors import LabError
from pgdl_lab.running import composing, pipeline
from pgdl_lab.running.folders import RUN_ID
from tests.conftest import Lab, environment
from tests.trainings import small

WARNING = "The made-up finger is a comb."
FEM = '''
import logging
from dataclasses import dataclass
from pathlib import Path
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.core.paths import ROOT
from pgdl_lab.core.registry import register
from tests.synthetic import snapshots

@register("fem", "made_up")
@dataclass(frozen=True)
class MadeUp(Fem):
    """Snapshots out of a formula; each simulation leaves a line in a file."""

    def simulate(self, finger, observation):
        logging.getLogger(__name__).warning("WARNING")
        with (ROOT / "simulations").open("a") as file:
            file.write("one\\n")
        return snapshots(cell_mm=2.5, count=observation.snapshots)
'''.replace("WARNING", WARNING)

SMALL = [
    "fem=made_up", "model=mlp", "model.width=16", "model.depth=2", "observation.snapshots=20", "split.points=500",
    "trainer.max_epochs=3", "trainer.progress=false", "observation.points=398",
]  # fmt: skip


@pytest.fixture(autouse=True)
def made_up(tmp_path: Path, migrated_database: Path) -> None:
    folder = tmp_path / "plugins" / "fem"
    folder.mkdir(parents=True)
    (folder / "made_up.py").write_text(FEM)
    (tmp_path / "mlflow.db").write_bytes(migrated_database.read_bytes())


def tracked(root: Path, folder: Path) -> Run:
    return MlflowClient(f"sqlite:///{root}/mlflow.db").get_run((folder / RUN_ID).read_text())


def simulations(root: Path) -> int:
    return len((root / "simulations").read_text().splitlines())


def test_a_run_leaves_what_it_promises(lab: Lab, tmp_path: Path) -> None:
    done = lab(*SMALL, "split=extrapolate", "loss=[data,boundary]", "seed=3")
    assert done.returncode == 0, done.stderr
    folder = (tmp_path / "runs" / "latest").resolve()
    assert {path.name for path in folder.iterdir()} == {
        "checkpoints", "config.yaml", "figures", "metrics.json", RUN_ID, "run.log", "surrogate.pt",
    }  # fmt: skip
    metrics = json.loads((folder / "metrics.json").read_text())
    assert {key: metrics[key] for key in ("finger", "fem", "split", "model", "losses", "seed", "train_points")} == {
        "finger": "pneunet", "fem": "made_up", "split": "extrapolate", "model": "mlp", "losses": ["data", "boundary"],
        "seed": 3, "train_points": 500,
    }  # fmt: skip
    assert set(metrics["seconds"]) == {"simulate", "simulate_cached", "train", "assess"}
    assert metrics["points"] == sum(metrics[f"{part}_points"] for part in ("train", "selection", "test"))
    surrogate = pgdl_lab.load(folder / "surrogate.pt")
    assert surrogate.predict(np.zeros((4, 2)), [10.0, 20.0]).shape == (2, 4, 2)
    run = tracked(tmp_path, folder)
    assert run.info.status == "FINISHED"
    assert run.data.metrics["mse_mm2/x"] == metrics["mse_mm2"]["x"]
    assert run.inputs.dataset_inputs[0].dataset.name == "snapshots"
    history = MlflowClient(f"sqlite:///{tmp_path}/mlflow.db").get_metric_history(run.info.run_id, "loss")
    assert history, sorted(run.data.metrics)


def test_a_multirun_simulates_once_and_nests_its_runs(lab: Lab, tmp_path: Path) -> None:
    done = lab("-m", *SMALL, "split=random,extrapolate", "loss=[data],[data,navier_cauchy]")
    assert done.returncode == 0, done.stderr
    assert simulations(tmp_path) == 1
    sweep = (tmp_path / "runs" / "latest").resolve().parent
    parent = tracked(tmp_path, sweep)
    jobs = [tracked(tmp_path, sweep / job) for job in "0123"]
    assert [run.info.status for run in [parent, *jobs]] == ["FINISHED"] * 5
    assert {job.data.tags["mlflow.parentRunId"] for job in jobs} == {parent.info.run_id}
    assert len({(job.data.tags["split"], job.data.tags["loss"]) for job in jobs}) == 4
    assert done.stdout.count(WARNING) == 4  # by the run that simulated and by those that found it
    for job in "0123":
        metrics = json.loads((sweep / job / "metrics.json").read_text())
        assert WARNING in metrics["warnings"] and metrics["discretisation_error"] is None
        assert WARNING in pgdl_lab.load(sweep / job / "surrogate.pt").warnings


def test_a_split_that_cannot_be_made_is_refused_before_the_simulation(lab: Lab, tmp_path: Path) -> None:
    done = lab(*SMALL, "split.points=7960")
    assert done.returncode == 1
    assert "leaves none to test on" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "simulations").exists()
    assert list((tmp_path / "runs").iterdir()) == []


def test_a_loss_that_a_model_cannot_use_is_refused_before_the_simulation_or_noted(lab: Lab, tmp_path: Path) -> None:
    own = ["model=gaussian_process", "fem=made_up", "observation.snapshots=20", "observation.points=398"]
    own += ["split.points=200", "model.points=50", "model.modes=4"]
    refused = lab(*own, "loss=[boundary]")
    assert refused.returncode == 1 and "loss=[boundary] does not count them" in refused.stderr
    assert len(refused.stderr.splitlines()) == 1 and not (tmp_path / "simulations").exists()
    done = lab(*own, "loss=[data,boundary]")
    assert done.returncode == 0, done.stderr
    assert "model=gaussian_process leaves out loss boundary" in done.stdout + done.stderr
    metrics = json.loads((tmp_path / "runs" / "latest" / "metrics.json").read_text())
    assert metrics["left_out"] == {"boundary": "it is fitted to the data alone, clamped points too"}


def test_a_killed_training_goes_on_where_it_was(lab: Lab, tmp_path: Path) -> None:
    endless = ["trainer.max_epochs=100000", "trainer.checkpoint_every_s=0", "trainer.log_every_s=0"]
    command = [sys.executable, "-m", "pgdl_lab", *SMALL, *endless, "trainer.max_time=4"]
    process = subprocess.Popen(command, env=environment(tmp_path), cwd=tmp_path, stdout=subprocess.DEVNULL)
    running = tmp_path / "runs" / "unfinished"
    while not (running / "checkpoints" / "last.ckpt").exists():
        assert process.poll() is None, "the training ended before it could be killed"
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    folder = running.resolve()
    assert tracked(tmp_path, folder).info.status == "RUNNING"
    assert not (folder / "surrogate.pt").exists()
    before = torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)["history"]
    assert before

    done = lab("resume=runs/latest")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs" / "latest").resolve() == folder and not running.is_symlink()
    assert simulations(tmp_path) == 1
    assert tracked(tmp_path, folder).info.status == "FINISHED"
    history = pgdl_lab.load(folder / "surrogate.pt").record.history
    assert history[: len(before)] == before  # the times in it would differ if it had begun anew
    assert len(history) > len(before)
    assert history[-1]["seconds"] == pytest.approx(4, abs=1)


def test_a_surrogate_that_cannot_be_told_its_error_is_there_all_the_same(
    tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    made = composing.experiment(["model=pod", "split.points=500", "yardstick=null"])
    monkeypatch.setattr(pipeline, "simulate", lambda *_: (small(), root / "snapshots.h5", True))
    saved: list[Path] = []
    original = pgdl_lab.Surrogate.save

    def save(surrogate: pgdl_lab.Surrogate, path: Path) -> None:
        saved.append(path)
        if len(saved) == 2:
            raise LabError("The disk is full.")
        original(surrogate, path)

    monkeypatch.setattr(pgdl_lab.Surrogate, "save", save)
    tracked: Any = SimpleNamespace(log_snapshots=lambda *_: None, log_metrics=lambda *_: None, flush=lambda: None)
    metrics = pipeline.run(made, tmp_path, tracked)
    assert len(saved) == 2 and "does not tell its own error: The disk is full." in caplog.text
    assert json.loads((tmp_path / "metrics.json").read_text())["surrogate_error"] == metrics["surrogate_error"]
    assert pgdl_lab.load(tmp_path / "surrogate.pt").error == {}
