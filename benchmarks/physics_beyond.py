"""What terms of physics gain beyond the trained pressures by being visited there, where there are no data.

    python benchmarks/physics_beyond.py [--seconds 600]

The trainings of `physics_ablation.py` on split extrapolate, up to 44 kPa, each term with pressures drawn up to 44 kPa
("trained") and up to 50 kPa ("of interest", what a training does). Each result is kept under runs/physics_beyond, where
a later call goes on, for so many seconds (default: until all are done); then the table is printed.
"""

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from benchmarks import common
from benchmarks.physics_ablation import BATCH, CHAMBERS, TERMS, WORTHS_MM, Case, Setting, geometric_mean, train
from pgdl_lab.learning import left_out

SEEDS, SHARES = range(3), (0.01, 0.002)
REACHES = {"trained": 44.0, "of interest": 50.0}  # [kPa]


@dataclass(frozen=True)
class Reached:
    """A training and the pressures that its terms of physics are visited at."""

    case: Case
    reach: str


def trials(seeds: Sequence[int], shares: Sequence[float], worths_mm: Sequence[float]) -> list[Reached]:
    """All trainings, seed by seed, so that a broken-off series has as many of each."""
    found = []
    for seed, share in itertools.product(seeds, shares):
        found.append(Reached(Case(seed, "extrapolate", share, "none", 0.0), "trained"))
        for term, worth, reach in itertools.product(TERMS, worths_mm, REACHES):
            found.append(Reached(Case(seed, "extrapolate", share, term, worth), reach))
    return found


def compared(results: dict[Reached, dict[str, Any]], share: float, term: str, worth: float, error: str) -> list[str]:
    """Error with a term by that of data alone for each reach: geometric mean, least and greatest over the seeds."""
    cells = []
    for reach in REACHES:
        ratios = []
        for seed in SEEDS:
            ours = results.get(Reached(Case(seed, "extrapolate", share, term, worth), reach))
            alone = results.get(Reached(Case(seed, "extrapolate", share, "none", 0.0), "trained"))
            if ours and alone and not ours["failed"] and not alone["failed"]:
                ratios.append(ours[error] / alone[error])
        cells.append(common.spread(ratios, geometric_mean, ".2f") if ratios else "–")
    return cells


def main() -> None:
    """Train what is missing and print."""
    left_out.FEW = 0  # error bars of few points take five trainings more, and nobody asks for them here
    arguments = common.parser(__doc__)
    arguments.add_argument("--seconds", type=float, default=math.inf, help="begin no training after that time")
    given = common.parsed(arguments)
    few = 1 if given.quick else None
    deadline, setting = time.monotonic() + given.seconds, Setting.of(given.quick)
    store, _ = common.folders("physics_beyond", given.quick)
    results: dict[Reached, dict[str, Any]] = {}
    for trial in trials(SEEDS[:few], SHARES[:few], WORTHS_MM[:few]):
        name = common.digest([CHAMBERS, BATCH, setting.steps, asdict(trial)])
        work = partial(train, trial.case, setting, REACHES[trial.reach])
        if (found := common.kept(store / f"{name}.json", work, deadline)) is not None:
            results[trial] = found
    title = "RMS error by that of data alone: geometric mean (least … greatest) over seeds"
    reaches = [f"{where}, physics up to {kpa:g} kPa" for where in ("above 44", "up to 44") for kpa in REACHES.values()]
    shown = common.table(title, ("points", "term", "worth [mm]", *reaches), left=0)
    for share, term, worth in itertools.product(SHARES[:few], TERMS, WORTHS_MM[:few]):
        cells = [cell for error in ("beyond_mm", "within_mm") for cell in compared(results, share, term, worth, error)]
        shown.add_row(f"{share:.1%}", term, f"{worth:g}", *cells)
    common.show(shown)
    failed = sum(result["failed"] for result in results.values())
    print(f"{len(results)} trainings, {failed} failed")


if __name__ == "__main__":
    main()
