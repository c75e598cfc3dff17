"""Errors and error bars between the points that were observed: the same simulation seen at four times as many.

    python benchmarks/between_points.py [finger ...]

Trains the default model on the usual observation, both splits, and asks it for the points of the finer one. `at` are
points that both observations have, or that lie as near to one as a fiftieth of a triangle; `between` all others. Given
are the mean squared error, the share of errors within the 95 % bar, and the median bar.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pgdl_lab.core import paths
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.scene import Scene
from pgdl_lab.running import cache
from pgdl_lab.running.composing import experiment
from pgdl_lab.surrogate.triangulation import Triangulation

FINGERS, SPLITS, FINER, NEAR = ("pneunet", "joints", "bellows"), ("random", "extrapolate"), 4, 0.98


def main() -> None:
    """Print the table."""
    table = Table(title=f"At observed points and between them, of {FINER} times as many")
    for heading in ("finger", "split", "", "points", "MSE x mm²", "MSE z mm²", "in bar x", "in bar z", "bar mm"):
        table.add_column(heading, justify="left" if heading in ("finger", "split", "") else "right")
    for finger in sys.argv[1:] or FINGERS:
        for split in SPLITS:
            trial = experiment([f"finger={finger}", f"split={split}", "fem.estimate_error=false"])
            folder, seen = paths.RUNS / "snapshots", trial.observation
            observed, *_ = cache.simulate(trial.finger, trial.fem, seen, folder)
            finer, *_ = cache.simulate(trial.finger, trial.fem, replace(seen, points=FINER * seen.points), folder)
            train = trial.split.train_points(observed, trial.seed)
            scene = Scene.of(trial.finger, observed)
            with tempfile.TemporaryDirectory() as place:
                surrogate = trial.model.fit(
                    Training.of(
                        Samples.of(observed, train), scene, trial.loss, replace(trial.trainer, progress=False),
                        trial.optimizer, trial.seed, Path(place), {},
                    )
                )  # fmt: skip
            error = np.abs(surrogate.predict(finer.domain.points_mm, finer.pressures_kpa) - finer.displacements)
            bars = surrogate.error_bar(finer.domain.points_mm, finer.pressures_kpa)
            assert bars is not None  # the default model has them
            _, weights = Triangulation(scene.domain.points_mm, scene.domain.cells).locate(finer.domain.points_mm)
            near = weights.max(axis=1) > NEAR
            for name, which in (("at", near), ("between", ~near)):
                mse = (error[:, which] ** 2).mean(axis=(0, 1))
                covered = (error[:, which] <= bars[:, which, None]).mean(axis=(0, 1))
                table.add_row(
                    finger, split, name, str(which.sum()), *(f"{value:.1e}" for value in mse),
                    *(f"{share:.0%}" for share in covered), f"{np.median(bars[:, which]):.1e}",
                )  # fmt: skip
        table.add_section()
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
