"""Searches as a user starts them: real processes on a body that is computed in no time."""

import csv
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import optuna
import pytest
from mlflow import MlflowClient
from mlflow.entities import Run
from optuna.trial import FrozenTrial, TrialState

from pgdl_lab.search.storage import open_storage
from pgdl_lab.search.study import LOST, RETRY_OF
from tests import postgres
from tests.conftest import Lab, environment

TOY = '''
import time
from dataclasses import dataclass
import numpy as np
from pgdl_lab.errors import LabError
from pgdl_lab.fem import Fem
from pgdl_lab.registry import register
from pgdl_lab.snapshots import Snapshots
from tests.synthetic import snapshots

@register("fem", "toy")
@dataclass(frozen=True)
class Toy(Fem):
    """Three points, or a body to train on."""
    a: float = 0.5
    b: float = 0.5
    kind: str = "points"
    wait_s: float = 0.0

    def simulate(self, finger, observation):
        if self.kind == "burst":
            raise LabError("The finger burst.")
        time.sleep(60 if self.kind == "slow" else self.wait_s)
        if self.kind == "body":
            return snapshots(cell_mm=2.5, count=3)
        u = np.zeros((1, 3, 2))
        u[0, 1] = (self.a - 0.3) ** 2, self.b * (1 + self.a)
        none = np.zeros(0, dtype=np.int64)
        return Snapshots(np.eye(3, 2), np.array([[0, 1, 2]]), none, none, np.ones(1), u)
'''
SEARCH = ("-m", "sweep=search", "task=simulate", "fem=toy", "hydra.sweeper.objectives=[extremes_mm.fem.x.1]")


@pytest.fixture
def toy(tmp_path: Path, migrated_database: Path) -> Path:
    """A root with the plugin `fem=toy` and an empty database."""
    (tmp_path / "plugins" / "fem").mkdir(parents=True)
    (tmp_path / "plugins" / "fem" / "toy.py").write_text(TOY)
    shutil.copy(migrated_database, tmp_path / "mlflow.db")
    return tmp_path


def trials(root: Path, study: str = "search") -> list[FrozenTrial]:
    folder = root / "runs" / study
    if not (folder / "study.journal").exists():
        return []
    storage = open_storage(None, folder)
    names = [summary.study_name for summary in optuna.get_all_study_summaries(storage)]
    return optuna.load_study(study_name=study, storage=storage).trials if names else []


def runs(root: Path, study: str = "search") -> tuple[Run, dict[str, Run]]:
    """The parent run in MLflow and its children by their trial."""
    client = MlflowClient(f"sqlite:///{root}/mlflow.db")
    parent = client.get_run((root / "runs" / study / "mlflow_run_id").read_text())
    found = client.search_runs([parent.info.experiment_id])
    mine = [run for run in found if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    return parent, {run.data.tags["trial"]: run for run in mine}


def test_a_search_for_two_objectives_leaves_a_front_that_runs_again(lab: Lab, toy: Path) -> None:
    typed = [
        *(*SEARCH[:-1], "hydra.sweeper.objectives=[extremes_mm.fem.x.1,maximize extremes_mm.fem.z.1]"),
        *("fem.a=interval(0,1)", "fem.b=interval(0,1)"),
    ]
    done = lab(*typed, "hydra.sweeper.n_trials=5", "hydra.sweeper.workers=2")
    assert done.returncode == 0, done.stderr
    folder = toy / "runs" / "search"
    found = [json.loads((folder / str(n) / "metrics.json").read_text())["extremes_mm"]["fem"] for n in range(5)]
    pairs = {n: (found[n]["x"][1], found[n]["z"][1]) for n in range(5)}
    front = {
        n for n, (x, z) in pairs.items() if not any(o[0] <= x and o[1] >= z and o != (x, z) for o in pairs.values())
    }
    with (folder / "pareto.csv").open() as file:
        assert {int(row["trial"]) for row in csv.DictReader(file)} == front
    files = sorted((toy / "runs" / "best" / "experiment" / "search").glob("*.yaml"))
    assert [file.name for file in files] == [f"pareto_{place}.yaml" for place in range(1, len(front) + 1)]
    parent, children = runs(toy)
    assert parent.info.status == "FINISHED"
    assert {child.data.tags["trial_state"] for child in children.values()} == {"complete"}
    assert children["0"].data.metrics["objective/extremes_mm.fem.x.1"] == pairs[0][0]
    client = MlflowClient(f"sqlite:///{toy}/mlflow.db")
    figures = {Path(file.path).stem for file in client.list_artifacts(parent.info.run_id, "figures")}
    assert {"history", "parallel_coordinates", "pareto"} <= figures

    again = lab("experiment=search/pareto_1")
    assert again.returncode == 0, again.stderr
    best = json.loads((toy / "runs" / "latest" / "metrics.json").read_text())["extremes_mm"]["fem"]
    assert (best["x"][1], best["z"][1]) == min(pairs[n] for n in front)


@pytest.fixture
def workers(toy: Path) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Processes that are ended with the test."""
    started: list[subprocess.Popen[bytes]] = []
    yield started
    for process in started:
        process.kill()
        process.wait()


def ended(found: list[FrozenTrial]) -> list[FrozenTrial]:
    return [trial for trial in found if trial.state.is_finished() and LOST not in trial.user_attrs]


def test_nothing_is_lost_or_done_twice_when_workers_are_killed(
    toy: Path, workers: list[subprocess.Popen[bytes]]
) -> None:
    typed = [*SEARCH, "fem.a=interval(0,1)", "fem.wait_s=0.3", "hydra.sweeper.n_trials=12"]

    def start() -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "pgdl_lab", *typed]
        with (toy / "output.log").open("ab") as output:
            workers.append(subprocess.Popen(command, env=environment(toy), stdout=output, stderr=output))
        return workers[-1]

    def wait_for(count: int) -> None:
        limit = time.monotonic() + 60
        while len(ended(trials(toy))) < count:
            assert time.monotonic() < limit, (toy / "output.log").read_text()
            time.sleep(0.05)

    first, second = start(), start()
    wait_for(3)
    first.send_signal(signal.SIGKILL)
    wait_for(6)
    second.send_signal(signal.SIGKILL)
    first.wait()
    second.wait()
    assert start().wait(timeout=100) == 0, (toy / "output.log").read_text()
    found = trials(toy)
    assert len(ended(found)) == 12
    assert {trial.state for trial in ended(found)} == {TrialState.COMPLETE}
    drawn = {trial.number: {**trial.system_attrs.get("fixed_params", {}), **trial.params} for trial in found}
    lost = {trial.number: drawn[trial.number] for trial in found if LOST in trial.user_attrs}
    retried = {trial.user_attrs[RETRY_OF]: trial.params for trial in found if RETRY_OF in trial.user_attrs}
    assert all(lost[number] == params for number, params in retried.items())
    assert {number for number, params in lost.items() if params} == set(retried)
    assert len({trial.params["fem.a"] for trial in ended(found)}) == 12
    assert runs(toy)[0].info.status == "FINISHED"


def test_trials_that_fail_or_take_too_long_are_told_and_the_others_run_on(lab: Lab, toy: Path) -> None:
    brute = "hydra.sweeper.sampler={_target_:optuna.samplers.BruteForceSampler,seed:0}"
    limits = ("hydra.sweeper.trial_seconds=1.5", "hydra.sweeper.max_failure_rate=0.8", "hydra.sweeper.n_trials=3")
    done = lab(*SEARCH, "fem.kind=choice(points,burst,slow)", brute, *limits)
    assert done.returncode == 0, done.stderr
    states = {trial.params["fem.kind"]: (trial.state.name, trial.user_attrs.get("error")) for trial in trials(toy)}
    slow = "The trial took longer than hydra.sweeper.trial_seconds=1.5 s."
    assert states == {"points": ("COMPLETE", None), "burst": ("FAIL", "The finger burst."), "slow": ("FAIL", slow)}
    for error in ("The finger burst.", slow):
        assert f"failed: {error}" in done.stdout
    _, children = runs(toy)
    told = {child.data.tags.get("error"): child.info.status for child in children.values()}
    assert told == {None: "FINISHED", "The finger burst.": "FAILED", slow: "FAILED"}


def test_a_training_is_pruned_from_inside(lab: Lab, toy: Path) -> None:
    done = lab(
        *("-m", "sweep=search", "fem=toy", "fem.kind=body", "model=mlp", "loss=[data]", "yardstick=null"),
        *("split.points=200", "trainer.max_epochs=3", "trainer.progress=false", "model.width=range(4,9)"),
        *("hydra.sweeper.n_trials=2", "hydra.sweeper.pruner={_target_:optuna.pruners.ThresholdPruner,upper:1e-9}"),
    )
    assert done.returncode == 0, done.stderr
    found = trials(toy)
    assert [(trial.state, list(trial.intermediate_values)) for trial in found] == [(TrialState.PRUNED, [1])] * 2
    _, children = runs(toy)
    told = {(child.data.tags["trial_state"], child.info.status) for child in children.values()}
    assert told == {("pruned", "KILLED")}


def test_the_jobs_of_a_multirun_are_compared_and_one_that_fails_is_in_mlflow(lab: Lab, toy: Path) -> None:
    done = lab("-m", "task=simulate", "fem=toy", "fem.a=0.3,0.5", "finger.wall_mm=3,-3")
    assert done.returncode == 1
    assert "2 of the multirun's jobs failed" in done.stderr
    (folder,) = (path.parent for path in (toy / "runs").glob("*/comparison.csv"))
    with (folder / "comparison.csv").open() as file:
        rows = list(csv.DictReader(file))
    good = [(row["fem.a"], float(row["extremes_mm.fem.z.0"])) for row in rows if not row["error"]]
    assert [a for a, _ in good] == ["0.3", "0.5"]
    assert sum("finger.wall_mm is -3.0 mm" in row["error"] for row in rows) == 2
    client = MlflowClient(f"sqlite:///{toy}/mlflow.db")
    parent = (folder / "mlflow_run_id").read_text()
    assert {file.path for file in client.list_artifacts(parent)} == {"comparison.csv", "figures"}
    found = client.search_runs([client.get_run(parent).info.experiment_id])
    failed = [run for run in found if run.data.tags.get("mlflow.parentRunId") == parent]
    assert {run.info.status for run in failed} == {"FAILED"}
    assert len(failed) == 2
    assert {run.data.params["finger.wall_mm"] for run in failed} == {"-3"}


@pytest.fixture
def database(tmp_path: Path) -> Iterator[str]:
    """URL of an empty PostgreSQL database of its own."""
    pytest.importorskip("psycopg", reason="the Python package psycopg is not installed")
    if postgres.programs() is None:
        pytest.skip("PostgreSQL is not installed")
    with postgres.server(tmp_path, "fsync=off") as url:
        yield url


def test_workers_share_a_postgresql_database(lab: Lab, toy: Path, database: str) -> None:
    typed = ("fem.a=interval(0,1)", "hydra.sweeper.n_trials=6", "hydra.sweeper.workers=2")
    done = lab(*SEARCH, *typed, f"hydra.sweeper.storage='{database}'")
    assert done.returncode == 0, done.stderr
    found = optuna.load_study(study_name="search", storage=database).trials
    assert [trial.state for trial in found] == [TrialState.COMPLETE] * 6
    assert not (toy / "runs" / "search" / "study.journal").exists()
