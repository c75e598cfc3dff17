"""How many workers a study bears: empty trials per second and waits for its locks, on a journal file and PostgreSQL.

    python benchmarks/sweep_scaling.py [--trials 5000] [--workers 1 4 16 64] [--storages journal postgresql tables]

Every worker is a process that claims trials and tells their values through `SharedStudy`, as a search does, without
Hydra, MLflow and training. All of them run on this machine: it does the computing of 64 machines, so what it shows for
many workers is a lower bound, while the waits for the locks are those of a real search. Two settings are drawn at
random, as the time of a sampler is Optuna's. "busy" is the share of the time in which some worker holds the lock of the
study: what is left of it is what more workers could use. "a worker's CPU" is what a trial costs its worker; with the
journal, be it a file or in PostgreSQL, each of them reads what all others write. For comparison, "tables" are Optuna's
own in PostgreSQL (`RDBStorage`): a hundred trials tell.
"""

import multiprocessing
import os
import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import BaseStorage, RDBStorage
from optuna.trial import TrialState

from benchmarks.common import missing, parsed, parser, show, table
from pgdl_lab.search.journal import KernelLock
from pgdl_lab.search.settings import SearchSettings
from pgdl_lab.search.space import parse
from pgdl_lab.search.storage import open_storage
from pgdl_lab.search.study import SharedStudy
from tests import needs, postgres

SPACE = ("a=interval(0,1)", "b=interval(0,1)")
KINDS = ["journal", "postgresql", "tables"]
FORK = multiprocessing.get_context("fork")  # 64 times the import of Optuna would take minutes


class Timed(KernelLock):
    """A lock that adds up how long it was waited for and held [s]."""

    def __init__(self, lock: KernelLock) -> None:
        super().__init__(lock._path)
        self.waited, self.held, self._since = 0.0, 0.0, 0.0

    def acquire(self) -> bool:
        start = time.perf_counter()
        super().acquire()
        self._since = time.perf_counter()
        self.waited += self._since - start
        return True

    def release(self) -> None:
        self.held += time.perf_counter() - self._since
        super().release()


def opened(kind: str, url: str | None, folder: Path) -> BaseStorage:
    """The storage of this kind."""
    return RDBStorage(url) if kind == "tables" and url else open_storage(url, folder)


def work(kind: str, folder: Path, url: str | None, trials: int, barrier: Barrier, results: Any) -> None:
    """One worker; what it measured goes into `results`, or why it could not."""
    try:
        results.put(worked(kind, folder, url, trials, barrier))
    except Exception as error:
        results.put(repr(error))
        barrier.abort()


def worked(kind: str, folder: Path, url: str | None, trials: int, barrier: Barrier) -> tuple[float, ...]:
    """Start, end, number of trials, time waited for the lock, time that it was held and processor time [s]."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = {"_target_": "optuna.samplers.RandomSampler", "seed": 0}
    settings = SearchSettings("scaling", n_trials=trials, objectives=["value"], sampler=sampler)
    storage = opened(kind, url, folder)
    study = SharedStudy(folder, settings, storage, parse({}, SPACE), {})
    lock = study.lock = Timed(study.lock)
    barrier.wait()
    start, cpu, count = time.perf_counter(), time.process_time(), 0
    while claims := study.claim(lambda trial: None):
        study.tell(claims[0], [claims[0].trial.params["a"]])
        count += 1
    end = time.perf_counter()
    used = time.process_time() - cpu
    study.close()
    return start, end, count, lock.waited, lock.held, used


def measure(kind: str, workers: int, url: str | None, trials: int, folder: Path) -> list[str]:
    """A row of the table."""
    opened(kind, url, folder)  # the tables of Optuna cannot be made by several at once
    barrier, results = FORK.Barrier(workers), FORK.SimpleQueue()
    processes = [FORK.Process(target=work, args=(kind, folder, url, trials, barrier, results)) for _ in range(workers)]
    for process in processes:
        process.start()
    found: list[Any] = [results.get() for _ in processes]
    for process in processes:
        process.join()
    if failed := [each for each in found if isinstance(each, str)]:
        raise SystemExit(f"{len(failed)} workers failed, the first with {failed[0]}")
    starts, ends, counts, waited, held, cpu = zip(*found, strict=True)
    seconds = max(ends) - min(starts)
    told = optuna.load_study(study_name="scaling", storage=opened(kind, url, folder)).get_trials(deepcopy=False)
    complete = [trial for trial in told if trial.state is TrialState.COMPLETE]
    drawn = {(trial.params["a"], trial.params["b"]) for trial in complete}
    if not len(told) == len(complete) == len(drawn) == sum(counts) == trials:
        raise SystemExit(f"{trials} trials asked for; {sum(counts)} run, {len(told)} kept, {len(drawn)} different")
    return [
        f"{trials / seconds:.0f}",
        f"{1e3 * sum(held) / trials:.1f}",
        f"{1e3 * sum(waited) / trials:.1f}",
        f"{100 * sum(held) / seconds:.0f} %",
        f"{1e3 * sum(cpu) / trials:.1f}",
        f"{len(complete)} of {trials}",
    ]


def main() -> None:
    """Measure and print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=5000)
    arguments.add_argument("--workers", type=int, nargs="+", default=[1, 4, 16, 64])
    arguments.add_argument("--storages", nargs="+", default=KINDS[:2], choices=KINDS)
    chosen = parsed(arguments, trials=20, workers=[1, 2])
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # the server ends with this program
    headings = (
        "storage",
        "workers",
        "trials/s",
        "lock held (ms)",
        "waited (ms)",
        "busy",
        "a worker's CPU (ms)",
        "exact",
    )
    title = f"{chosen.trials} empty trials on one study, {os.cpu_count()} cores for all workers"
    shown = table(title, headings, left=0)
    for storage in chosen.storages:
        if storage != "journal" and needs.program("initdb") is None:
            missing(storage, f"Debian's {needs.DEBIAN['initdb']}")
            continue
        for workers in chosen.workers:
            with ExitStack() as stack:
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
                url = None
                if storage != "journal":
                    url = stack.enter_context(postgres.server("max_connections=200"))
                row = (storage, str(workers), *measure(storage, workers, url, chosen.trials, folder))
                shown.add_row(*row)
                print(*row, flush=True)
    show(shown)


if __name__ == "__main__":
    main()
