"""What a search costs beside its trials: milliseconds per trial of an empty job, and of plain Optuna in the same run.

    python benchmarks/sweep_overhead.py [--trials 200] [--profile]

Three loops over the same space of two settings with the same sampler, each on a journal file of its own: Optuna's
`optimize`; claims and results through `SharedStudy`; and `python -m pgdl_lab -m sweep=search` with a task that writes
metrics.json and nothing else, so with Hydra's configuration, a folder, a log and an MLflow run per trial. The start of
the program and the report at the end are not in the time of a trial, and shown by themselves.
"""

import contextlib
import cProfile
import io
import os
import pstats
import statistics
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType
from typing import Any

from benchmarks.common import parsed, parser, show, table

SPACE = ("finger.width_mm=interval(12,14)", "finger.wall_mm=interval(2.5,3.5)")
OBJECTIVE = "value"


def plain(folder: Path, trials: int) -> list[float]:
    """Seconds of each trial of Optuna's own loop."""
    import optuna
    from hydra.utils import instantiate

    from pgdl_lab.search.settings import DEFAULT_SAMPLER
    from pgdl_lab.search.study import making

    def objective(trial: optuna.Trial) -> float:
        return trial.suggest_float("width", 12, 14) - trial.suggest_float("wall", 2.5, 3.5)

    file = optuna.storages.journal.JournalFileBackend(str(folder / "plain.journal"))
    storage = optuna.storages.JournalStorage(file)
    with making("sampler"):
        sampler = instantiate(DEFAULT_SAMPLER)
    study = optuna.create_study(study_name="plain", storage=storage, sampler=sampler)
    ends = [time.perf_counter()]
    study.optimize(objective, n_trials=trials, callbacks=[lambda *_: ends.append(time.perf_counter())])
    return _differences(ends)


def shared(folder: Path, trials: int) -> list[float]:
    """Seconds of each trial of our own loop, without Hydra and MLflow."""
    from pgdl_lab.search.settings import SearchSettings
    from pgdl_lab.search.space import parse
    from pgdl_lab.search.storage import open_storage
    from pgdl_lab.search.study import SharedStudy

    folder = folder / "shared"
    folder.mkdir()
    settings = SearchSettings("shared", n_trials=trials, objectives=[OBJECTIVE])
    study = SharedStudy(folder, settings, open_storage(None, folder), parse({}, SPACE), {})
    ends = [time.perf_counter()]
    while claims := study.claim(lambda trial: None):
        study.tell(claims[0], [claims[0].trial.params["finger.width_mm"] - claims[0].trial.params["finger.wall_mm"]])
        ends.append(time.perf_counter())
    study.close()
    return _differences(ends)


def whole(trials: int) -> tuple[list[float], float]:
    """Seconds of each trial of the whole program, and those of its start and end."""
    import optuna

    from pgdl_lab import cli, tasks
    from pgdl_lab.core import paths
    from pgdl_lab.search.storage import open_storage
    from pgdl_lab.tasks import Job

    def run(job: Job) -> None:
        value = job.config.finger.width_mm - job.config.finger.wall_mm
        (job.folder / "metrics.json").write_text(f'{{"{OBJECTIVE}": {value}}}')

    empty: Any = ModuleType("pgdl_lab.tasks.simulate")  # in the place of a task that there is
    empty.run = run
    sys.modules[empty.__name__] = tasks.simulate = empty  # type: ignore[attr-defined]
    typed = [f"hydra.sweeper.objectives=[{OBJECTIVE}]", f"hydra.sweeper.n_trials={trials}", "hydra.sweeper.study=whole"]
    sys.argv = ["pgdl-lab", "-m", "sweep=search", "task=simulate", *typed, *SPACE]
    start = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        cli.main()
    seconds = time.perf_counter() - start
    found = optuna.load_study(study_name="whole", storage=open_storage(None, paths.RUNS / "whole")).trials
    starts = [trial.datetime_start.timestamp() for trial in found if trial.datetime_start]
    each = [*_differences(starts), found[-1].duration.total_seconds()] if found[-1].duration else []
    assert len(each) == trials, f"{len(each)} trials of {trials} ended"
    return each, seconds - sum(each)


def _differences(ends: list[float]) -> list[float]:
    return [after - before for before, after in zip(ends[:-1], ends[1:], strict=True)]


def main() -> None:
    """Run the three loops and print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=200)
    arguments.add_argument("--profile", action="store_true", help="show where the whole program spends its time")
    chosen = parsed(arguments, trials=5)
    with tempfile.TemporaryDirectory() as place:
        os.environ["PGDL_LAB_ROOT"] = place  # before the lab is imported
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        loops = {"plain Optuna": plain(Path(place), chosen.trials), "SharedStudy": shared(Path(place), chosen.trials)}
        profile = cProfile.Profile()
        if chosen.profile:
            profile.enable()
        loops["the whole program"], rest = whole(chosen.trials)
        if chosen.profile:
            profile.disable()
            pstats.Stats(profile).sort_stats("cumulative").print_stats(60)
        headings = ("loop", "median", "mean", "first 20", "last 20")
        shown = table(f"{chosen.trials} empty trials, milliseconds each", headings, left=0)
        for name, seconds in loops.items():
            means = (statistics.fmean(part) for part in (seconds, seconds[:20], seconds[-20:]))
            shown.add_row(name, *(f"{1e3 * value:.1f}" for value in (statistics.median(seconds), *means)))
        show(shown)
        print(f"start and report of the whole program: {rest:.1f} s")


if __name__ == "__main__":
    main()
