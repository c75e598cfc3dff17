"""Searches as a user starts them: real processes on a body that is computed in no time."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mlflow import MlflowClient
from mlflow.entities import Run
from optuna.trial import FrozenTrial, TrialState

from pgdl_lab.search.tally import LOST, RETRY_OF
from tests.conftest import CHECKOUT, environment
from tests.search.toy import SEARCH, make_toy, trials

TRAINING = ("-m", "sweep=search", "fem=toy", "fem.kind=body", "model=mlp", "loss=[data]", "yardstick=null")
COMMANDS = {
    "front": (
        *(*SEARCH[:-1], "hydra.sweeper.objectives=[extremes_mm.fem.x.1,maximize extremes_mm.fem.z.1]"),
        *("fem.a=interval(0,1)", "fem.b=interval(0,1)", "hydra.sweeper.n_trials=5", "hydra.sweeper.workers=2"),
    ),
    "again": ("experiment=front/pareto_1",),
    "failures": (
        *(*SEARCH, "fem.kind=choice(points,burst,slow)", "hydra.sweeper.trial_seconds=4", "hydra.sweeper.n_trials=3"),
        "hydra.sweeper.max_failure_rate=0.8",
        "hydra.sweeper.sampler={_target_:optuna.samplers.BruteForceSampler,seed:0}",
    ),
    "pruned": (
        *(*TRAINING, "split.points=200", "trainer.max_epochs=3", "trainer.progress=false", "model.width=range(4,9)"),
        *("hydra.sweeper.n_trials=2", "hydra.sweeper.pruner={_target_:optuna.pruners.ThresholdPruner,upper:1e-9}"),
    ),
    "trained": (
        *(*TRAINING, "split.points=200", "trainer.max_epochs=2", "trainer.progress=false", "model.width=range(4,9)"),
        *("optimizer.name=adam,nadam", "model.activation=tanh,relu", "hydra.sweeper.n_trials=2"),
    ),
    "trained again": ("experiment=trained/best",),
    "calibration": ("-m", "sweep=calibrate_small", "finger=joints", "fem=toy", "hydra.sweeper.n_trials=2"),
    "multirun": ("-m", "task=simulate", "fem=toy", "fem.a=0.3,0.5", "finger.wall_mm=3,-3"),
}
"""What is run in one process, the searches as studies of these names."""


Done = tuple[Path, dict[str, tuple[int, str]]]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, migrated_database: Path) -> Done:
    """Root in which all commands were run; exit code and output of each."""
    root = make_toy(tmp_path_factory.mktemp("searches"), migrated_database)
    named = [
        [*typed, f"hydra.sweeper.study={name}"] if any(text.startswith("sweep=") for text in typed) else [*typed]
        for name, typed in COMMANDS.items()
    ]
    process = subprocess.run(
        [sys.executable, str(CHECKOUT / "tests" / "search" / "driver.py")],
        input=json.dumps(named),
        env=environment(root),
        cwd=root,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
    )
    parts = re.split(r"^exit code (\d+)$", process.stdout, flags=re.MULTILINE)
    return root, {name: (int(code), text) for name, text, code in zip(COMMANDS, parts[0::2], parts[1::2], strict=False)}


def runs(root: Path, study: str = "search") -> tuple[Run, dict[str, Run]]:
    """The parent run in MLflow and its children by their trial."""
    client = MlflowClient(f"sqlite:///{root}/mlflow.db")
    parent = client.get_run((root / "runs" / study / "mlflow_run_id").read_text())
    found = client.search_runs([parent.info.experiment_id])
    mine = [run for run in found if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    return parent, {run.data.tags["trial"]: run for run in mine}


def metrics_of_run(root: Path, setting: str) -> dict:
    """Metrics of the one run by itself that has this line in its configuration."""
    folders = {path.parent for path in root.glob("runs/*_*_*/metrics.json")}
    (folder,) = {each for each in folders if setting in (each / "config.yaml").read_text()}
    return json.loads((folder / "metrics.json").read_text())


def test_a_search_for_two_objectives_leaves_a_front_that_runs_again(done: Done) -> None:
    root, told = done
    assert told["front"][0] == 0, told["front"][1]
    folder = root / "runs" / "front"
    found = [json.loads((folder / str(n) / "metrics.json").read_text())["extremes_mm"]["fem"] for n in range(5)]
    pairs = {n: (found[n]["x"][1], found[n]["z"][1]) for n in range(5)}
    front = {
        n for n, (x, z) in pairs.items() if not any(o[0] <= x and o[1] >= z and o != (x, z) for o in pairs.values())
    }
    with (folder / "pareto.csv").open() as file:
        assert {int(row["trial"]) for row in csv.DictReader(file)} == front
    files = sorted((root / "runs" / "best" / "experiment" / "front").glob("*.yaml"))
    assert [file.name for file in files] == [f"pareto_{place}.yaml" for place in range(1, len(front) + 1)]
    parent, children = runs(root, "front")
    assert parent.info.status == "FINISHED"
    assert {child.data.tags["trial_state"] for child in children.values()} == {"complete"}
    assert children["0"].data.metrics["objective/extremes_mm.fem.x.1"] == pairs[0][0]
    client = MlflowClient(f"sqlite:///{root}/mlflow.db")
    figures = {Path(file.path).stem for file in client.list_artifacts(parent.info.run_id, "figures")}
    assert {"history", "parallel_coordinates", "pareto"} <= figures

    assert told["again"][0] == 0, told["again"][1]
    best = metrics_of_run(root, "kind: points")["extremes_mm"]["fem"]
    assert (best["x"][1], best["z"][1]) == min(pairs[n] for n in front)


@pytest.fixture
def workers() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Processes that are ended with the test."""
    started: list[subprocess.Popen[bytes]] = []
    yield started
    for process in started:
        process.kill()
        process.wait()


def ended(found: list[FrozenTrial]) -> list[FrozenTrial]:
    return [trial for trial in found if trial.state.is_finished() and LOST not in trial.user_attrs]


def test_nothing_is_lost_or_done_twice_when_workers_are_killed(
    tmp_path: Path, migrated_database: Path, workers: list[subprocess.Popen[bytes]]
) -> None:
    toy = make_toy(tmp_path, migrated_database)
    typed = [*SEARCH[1:], "fem.a=interval(0,1)", "fem.wait_s=0.3", "hydra.sweeper.n_trials=12"]
    plain = (sys.executable, "-m", "pgdl_lab", "-m")

    def start(*command: str) -> subprocess.Popen[bytes]:
        slurm = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "SLURM_CPUS_PER_TASK": "1"}
        with (toy / "output.log").open("ab") as output:
            known = {**environment(toy), **slurm}
            workers.append(subprocess.Popen([*command, *typed], env=known, stdout=output, stderr=output))
        return workers[-1]

    def wait_for(count: int) -> None:
        limit = time.monotonic() + 120
        while len(ended(trials(toy))) < count:
            assert time.monotonic() < limit, (toy / "output.log").read_text()
            time.sleep(0.05)

    first, second = start("bash", str(CHECKOUT / "examples" / "slurm_workers.sh")), start(*plain)
    wait_for(3)
    first.send_signal(signal.SIGKILL)
    wait_for(6)
    second.send_signal(signal.SIGKILL)
    first.wait()
    second.wait()
    assert start(*plain).wait(timeout=150) == 0, (toy / "output.log").read_text()
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


def test_trials_that_fail_or_take_too_long_are_told_and_the_others_run_on(done: Done) -> None:
    root, told = done
    assert told["failures"][0] == 0, told["failures"][1]
    found = trials(root, "failures")
    states = {trial.params["fem.kind"]: (trial.state.name, trial.user_attrs.get("error")) for trial in found}
    slow = "The trial took longer than hydra.sweeper.trial_seconds=4 s."
    assert states == {"points": ("COMPLETE", None), "burst": ("FAIL", "The finger burst."), "slow": ("FAIL", slow)}
    for error in ("The finger burst.", slow):
        assert f"failed: {error}" in told["failures"][1]
    _, children = runs(root, "failures")
    kept = {child.data.tags.get("error"): child.info.status for child in children.values()}
    assert kept == {None: "FINISHED", "The finger burst.": "FAILED", slow: "FAILED"}


def test_the_best_training_runs_again_with_the_same_metrics(done: Done) -> None:
    root, told = done
    assert told["trained"][0] == told["trained again"][0] == 0, told["trained"][1] + told["trained again"][1]
    found = {trial.number: trial.value for trial in trials(root, "trained")}
    best = json.loads((root / "runs" / "trained" / str(min(found, key=found.__getitem__)) / "metrics.json").read_text())
    again = metrics_of_run(root, "kind: body")
    assert len(set(found.values())) == 2
    assert min(found.values()) == pytest.approx(sum(best["selection_mm2"].values()))
    assert best["points"] == sum(best[f"{part}_points"] for part in ("train", "selection", "test"))
    tested = f"which nothing was selected by, MSE x {best['mse_mm2']['x']:.4g}, z {best['mse_mm2']['z']:.4g} mm²"
    assert tested in told["trained"][1]
    assert tested in (root / "runs" / "best" / "experiment" / "trained" / "best.yaml").read_text()
    assert [again[key] for key in ("mse_mm2", "extremes_mm")] == [best[key] for key in ("mse_mm2", "extremes_mm")]


def test_a_training_is_pruned_from_inside(done: Done) -> None:
    root, told = done
    assert told["pruned"][0] == 0, told["pruned"][1]
    found = trials(root, "pruned")
    assert [(trial.state, list(trial.intermediate_values)) for trial in found] == [(TrialState.PRUNED, [1])] * 2
    _, children = runs(root, "pruned")
    kept = {(child.data.tags["trial_state"], child.info.status) for child in children.values()}
    assert kept == {("pruned", "KILLED")}


def test_a_calibration_is_of_the_finger_that_is_typed(done: Done) -> None:
    root, told = done
    assert told["calibration"][0] == 0, told["calibration"][1]
    found = trials(root, "calibration")
    searched = {"finger.phalanx_mm", "finger.tip_mm", "finger.chamber_height_mm"}
    assert [set(trial.params) for trial in found] == [searched] * 2
    assert [trial.value for trial in found] == [pytest.approx(69.94 / (0.02 * 69.94))] * 2  # a toy does not bend
    assert "All 2 trials have the same values" in told["calibration"][1]
    assert "have the same values" not in told["front"][1]


def test_the_jobs_of_a_multirun_are_compared_and_one_that_fails_is_in_mlflow(done: Done) -> None:
    root, told = done
    assert told["multirun"][0] == 1
    assert "2 of the multirun's jobs failed" in told["multirun"][1]
    table = told["multirun"][1].partition("The runs side by side")[2]
    assert re.search(r"simulation.*\n.*\[s\]", table), table
    assert "least u_z" not in table  # it is the same in all jobs
    assert "fem.a=0.5  finger.wall_mm=-3 " in table
    (folder,) = (path.parent for path in (root / "runs").glob("*/comparison.csv"))
    with (folder / "comparison.csv").open() as file:
        rows = list(csv.DictReader(file))
    good = [(row["fem.a"], float(row["extremes_mm.fem.z.0"])) for row in rows if not row["error"]]
    assert [a for a, _ in good] == ["0.3", "0.5"]
    assert sum("finger.wall_mm is -3.0 mm" in row["error"] for row in rows) == 2
    client = MlflowClient(f"sqlite:///{root}/mlflow.db")
    parent = (folder / "mlflow_run_id").read_text()
    assert {file.path for file in client.list_artifacts(parent)} == {"comparison.csv", "figures"}
    found = client.search_runs([client.get_run(parent).info.experiment_id])
    failed = [run for run in found if run.data.tags.get("mlflow.parentRunId") == parent]
    assert {run.info.status for run in failed} == {"FAILED"}
    assert len(failed) == 2
    assert {run.data.params["finger.wall_mm"] for run in failed} == {"-3"}
