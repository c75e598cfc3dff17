"""The default model on fingers that nobody looked at when its structure was chosen, both splits.

    python benchmarks/unseen_fingers.py [--seconds 600]

Three altered fingers and nothing else changed; a dozen minutes on one core. Each training is stored under
runs/unseen_fingers as soon as it ends, and a later call goes on where one of so many seconds stopped. Errors are
medians over the seeds, with the worst seed in brackets: mean squares over all points that were not trained on and, for
`extrapolate`, at the worst of the pressures that the split highlights. `in bar` is the least share of errors within the
95 % error bar, over the whole and over those pressures.
"""

import itertools
import math
import time
from functools import partial
from statistics import median
from typing import Any

from benchmarks.common import digest, folders, kept, parsed, parser, show, table
from benchmarks.scenes import fitted, scene, simulated
from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.core import registry
from pgdl_lab.running.experiment import Experiment

FINGERS = {
    "pneunet, 6 chambers, walls of 2.2 mm": ["pneunet", "finger.chambers=6", "finger.wall_mm=2.2"],
    "joints, 2 of 4 chambers, phalanx of 25 mm": [
        "joints", "finger.joints=2", "finger.chambers=4", "finger.phalanx_mm=25",
    ],
    "bellows, hanging: gravity along x": ["bellows", "finger.gravity_m_s2=[9.81,0.0]"],
}  # fmt: skip
SPLITS, SEEDS = ("random", "extrapolate"), (0, 1, 2)


def train(trial: Experiment) -> dict[str, Any]:
    """Errors and coverage of one training."""
    snapshots = simulated(trial)
    points = trial.split.train_points(snapshots, trial.seed)
    surrogate, seconds = fitted(trial, snapshots, points)
    where = snapshots.domain.points_mm, snapshots.pressures_kpa
    found = Comparison(snapshots, surrogate.predict(*where), points, surrogate.error_bar(*where))
    rows = found.by_pressure()
    shown = [rows[i] for i in trial.split.highlights(snapshots.cases)]
    bars = found.error_bar()
    return {
        "seconds": seconds,
        "x": found.mse_mm2()["x"],
        "z": found.mse_mm2()["z"],
        "beyond_x": max(row["mse_x_mm2"] for row in shown),
        "beyond_z": max(row["mse_z_mm2"] for row in shown),
        "covered": min(bars["covered_x"], bars["covered_z"]) if bars else math.nan,
        "beyond_covered": min(row["covered"] for row in shown) if bars else math.nan,
    }


def cell(results: list[dict[str, Any]], key: str) -> str:
    """Median and worst."""
    values = [row[key] for row in results]
    worst = min(values) if "covered" in key else max(values)
    form = ".0%" if "covered" in key else ".1e"
    return f"{median(values):{form}} ({worst:{form}})"


def main() -> None:
    """Train what is missing and print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--seconds", type=float, default=math.inf, help="begin no training after that time")
    given = parsed(arguments)
    deadline, (store, _) = time.monotonic() + given.seconds, folders("unseen_fingers", given.quick)
    names, seeds = (list(FINGERS)[-1:], SEEDS[:1]) if given.quick else (list(FINGERS), SEEDS)
    keys = ("x", "z", "covered", "beyond_x", "beyond_z", "beyond_covered")
    headings = ("MSE x", "MSE z", "in bar", "highlights x", "highlights z", "in bar there")
    title = "MSE [mm²], median (worst) over seeds, of the default model"
    shown = table(title, ("finger", "split", "seeds", *headings, "seconds"), left=2)
    for name, split in itertools.product(names, SPLITS):
        results = []
        for seed in seeds:
            choices = [*FINGERS[name], f"split={split}", f"seed={seed}", "fem.estimate_error=false"]
            trial = scene(*choices, quick=given.quick)
            parts = [registry.describe(part) for part in (trial.finger, trial.fem, trial.split, trial.model)]
            path = store / f"{digest([*parts, trial.seed])}.json"
            if (found := kept(path, partial(train, trial), deadline)) is not None:
                results.append(found)
        if results:
            seconds = f"{median(row['seconds'] for row in results):.0f}"
            shown.add_row(name, split, str(len(results)), *(cell(results, key) for key in keys), seconds)
    show(shown)


if __name__ == "__main__":
    main()
