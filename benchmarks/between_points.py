"""Errors and error bars between the points that were observed: the same simulation seen at four times as many.

    python benchmarks/between_points.py [finger ...]

Trains the default model on the usual observation, both splits, and asks it for the points of the finer one. `at` are
points that both observations have, or that lie as near to one as a fiftieth of a triangle; `between` all others. Given
are the mean squared error, the share of errors within the 95 % bar, and the median bar.
"""

from dataclasses import replace

import numpy as np

from benchmarks.common import parsed, parser, show, table
from benchmarks.scenes import FINGERS, fitted, scene, simulated
from pgdl_lab.surrogate.triangulation import Triangulation

SPLITS, FINER, NEAR = ("random", "extrapolate"), 4, 0.98


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("fingers", nargs="*", default=FINGERS)
    given = parsed(arguments, fingers=FINGERS[:1])
    headings = ("finger", "split", "", "points", "MSE x mm²", "MSE z mm²", "in bar x", "in bar z", "bar mm")
    shown = table(f"At observed points and between them, of {FINER} times as many", headings, left=3)
    for finger in given.fingers:
        for split in SPLITS:
            trial = scene(finger, f"split={split}", "fem.estimate_error=false", quick=given.quick)
            seen = trial.observation
            observed = simulated(trial)
            finer = simulated(replace(trial, observation=replace(seen, points=FINER * seen.points)))
            surrogate, _ = fitted(trial, observed, trial.split.train_points(observed, trial.seed))
            error = np.abs(surrogate.predict(finer.domain.points_mm, finer.pressures_kpa) - finer.displacements)
            bars = surrogate.error_bar(finer.domain.points_mm, finer.pressures_kpa)
            assert bars is not None  # the default model has them
            _, weights = Triangulation(observed.domain.points_mm, observed.domain.cells).locate(finer.domain.points_mm)
            near = weights.max(axis=1) > NEAR
            for name, which in (("at", near), ("between", ~near)):
                mse = (error[:, which] ** 2).mean(axis=(0, 1))
                covered = (error[:, which] <= bars[:, which, None]).mean(axis=(0, 1))
                shown.add_row(
                    finger, split, name, str(which.sum()), *(f"{value:.1e}" for value in mse),
                    *(f"{share:.0%}" for share in covered), f"{np.median(bars[:, which]):.1e}",
                )  # fmt: skip
        shown.add_section()
    show(shown)


if __name__ == "__main__":
    main()
