"""How much sooner a search ends with several workers: the same trainings with 1, 2 and 4, on a journal and PostgreSQL.

    python benchmarks/sweep_speedup.py [--trials 8] [--workers 1 2 4] [--storages journal postgresql]

Each is `python -m pgdl_lab -m sweep=seeds` on the cached snapshots of the default finger, in a root of its own, with as
many seeds as trials, so that every row does the same trainings. The processor time says what more workers cost
beside the trainings, whatever else the machine does: each loads the libraries, some six seconds of one core. On N cores
more than N workers gain nothing.
"""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import optuna
from optuna.trial import TrialState

from benchmarks.common import missing, parsed, parser, show, table
from benchmarks.scenes import COARSE, SMALL, scene, simulated
from pgdl_lab.core import paths
from pgdl_lab.search.storage import open_storage
from tests import needs, postgres

STORAGES = ["journal", "postgresql"]


def measure(workers: int, storage: str, trials: int, choices: list[str], database: Path) -> tuple[float, float, int]:
    """Seconds until the search has ended, processor time [s] and the number of different seeds that were trained."""
    with ExitStack() as stack:
        root = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url = None
        if storage == "postgresql":
            url = stack.enter_context(postgres.server())
        (root / "runs").mkdir()
        (root / "runs" / "snapshots").symlink_to(paths.RUNS / "snapshots")
        shutil.copy(database, root / "mlflow.db")
        command = [sys.executable, "-m", "pgdl_lab", "-m", "sweep=seeds", f"seed=range(0,{trials})"]
        command += [*choices, f"hydra.sweeper.n_trials={trials}"]
        command += [f"hydra.sweeper.workers={workers}", *([f"hydra.sweeper.storage='{url}'"] if url else [])]
        environment = {**os.environ, "PGDL_LAB_ROOT": str(root)}
        before = _processor()
        start = time.perf_counter()
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - start
        if done.returncode:
            raise SystemExit(done.stdout + done.stderr)
        found = optuna.load_study(study_name="seeds", storage=open_storage(url, root / "runs" / "seeds")).trials
        complete = [trial for trial in found if trial.state is TrialState.COMPLETE]
        seeds = {trial.params["seed"] for trial in complete}
        if not len(found) == len(complete) == len(seeds) == trials:
            raise SystemExit(f"{trials} trials asked for, {len(complete)} of {len(found)} complete, {len(seeds)} seeds")
        return seconds, _processor() - before, len(seeds)


def _processor() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure and print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=8)
    arguments.add_argument("--epochs", type=int, default=20)
    arguments.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    arguments.add_argument(
        "--storages", nargs="+", default=["journal", "postgresql"], choices=["journal", "postgresql"]
    )
    chosen = parsed(arguments, trials=2, epochs=2, workers=[2], storages=["journal"])
    choices = [*(SMALL["pneunet"] + COARSE if chosen.quick else []), f"trainer.max_epochs={chosen.epochs}"]
    simulated(scene("pneunet", quick=chosen.quick))  # all rows find the snapshots there
    headings = ("storage", "workers", "time (s)", "speed-up", "processor time (s)", "trials")
    title = f"{chosen.trials} trainings of {chosen.epochs} epochs on {os.cpu_count()} cores"
    shown = table(title, headings, left=0)
    with tempfile.TemporaryDirectory() as place:
        database = Path(place) / "mlflow.db"
        from mlflow import MlflowClient

        MlflowClient(f"sqlite:///{database}").search_experiments()  # makes the tables, which takes seconds
        for storage in chosen.storages:
            if storage == "postgresql" and needs.program("initdb") is None:
                missing(storage, f"Debian's {needs.DEBIAN['initdb']}")
                continue
            first = None
            for workers in chosen.workers:
                seconds, processor, count = measure(workers, storage, chosen.trials, choices, database)
                first = first or seconds
                figures = (f"{seconds:.1f}", f"{first / seconds:.2f}", f"{processor:.1f}", f"{count}")
                print(storage, workers, *figures, flush=True)
                shown.add_row(storage, str(workers), *figures)
    show(shown)


if __name__ == "__main__":
    main()
