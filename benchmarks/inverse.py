"""Where the tip is if the finite elements are run at the pressure that the surrogate gives for it.

    python benchmarks/inverse.py RUN [--tips 1000] [--solves 3]

RUN is the folder of a training. Tips are those of the simulation at random pressures, interpolated between its
snapshots by a cubic spline, whose error is measured by leaving out every other snapshot. For each the surrogate is
asked for the pressure, and the simulation for the tip there; for a few of them the finite elements are solved anew.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from benchmarks.common import parsed, parser
from benchmarks.scenes import fitted, scene, simulated
from pgdl_lab.core.observation import Observation
from pgdl_lab.running import cache, composing
from pgdl_lab.running.experiment import Experiment, restore
from pgdl_lab.running.folders import stored_run, stored_surrogate
from pgdl_lab.surrogate.curvature import mean_curvature_per_m

Floats = NDArray[np.float64]


def main() -> None:
    """Print the errors."""
    arguments = parser(__doc__)
    arguments.add_argument("run", nargs="?", default="runs/latest", help="folder of a training")
    arguments.add_argument("--tips", type=int, default=1000)
    arguments.add_argument("--solves", type=int, default=3, help="how many of them the finite elements are solved for")
    given = parsed(arguments, tips=100, solves=1)
    if given.quick:
        made = scene("pneunet", quick=True)
        snapshots = simulated(made)
        surrogate, _ = fitted(made, snapshots, made.split.train_points(snapshots, made.seed))
    else:
        composing.store_choices()
        folder = stored_run(given.run)
        surrogate = stored_surrogate(folder)
        made = Experiment.from_config(restore(folder / "config.yaml"))
        snapshots = simulated(made)
    pressures, tip = snapshots.pressures_kpa, snapshots.domain.base[-1]
    path = snapshots.domain.points_mm[tip] + snapshots.displacements[:, tip]
    there = CubicSpline(pressures, path)
    halved = CubicSpline(pressures[::2], path[::2])(pressures[1:-1:2]) - path[1:-1:2]
    print(
        f"Spline between the snapshots: {np.abs(halved).max() / 16:.1e} mm at most (a 16th of what half of them err by)"
    )

    rng = np.random.default_rng(0)
    asked_kpa = rng.uniform(pressures[0], pressures[-1], given.tips)
    start = time.perf_counter()
    answers = [surrogate.pressure_for(tip=target) for target in there(asked_kpa)]
    seconds = time.perf_counter() - start
    found_kpa = np.array([answer.kpa for answer in answers])
    error_mm = np.linalg.norm(there(np.clip(found_kpa, pressures[0], pressures[-1])) - there(asked_kpa), axis=1)
    off_kpa = np.abs(found_kpa - asked_kpa)
    print(f"{given.tips} tips: {sum(answer.reached for answer in answers)} reached; error of the tip, median "
          f"{np.median(error_mm):.1e}, 99 % {np.quantile(error_mm, 0.99):.1e}, most {error_mm.max():.1e} mm; of the "
          f"pressure, most {off_kpa.max():.1e} kPa; {1e6 * seconds / given.tips:.0f} µs each")  # fmt: skip

    lines = snapshots.domain.points_mm[snapshots.domain.base] + snapshots.displacements[:, snapshots.domain.base]
    curvatures = np.array([mean_curvature_per_m(line) for line in lines])
    bent = [surrogate.pressure_for(curvature=curvature) for curvature in curvatures]
    off = np.abs([answer.kpa for answer in bent] - pressures)
    print(f"{len(bent)} curvatures: {sum(answer.reached for answer in bent)} reached; error of the pressure, most "
          f"{off.max():.1e} kPa")  # fmt: skip

    unasked = {"estimate_error": False} if "estimate_error" in vars(made.fem) else {}
    fem = replace(made.fem, **unasked)
    for k in range(given.solves):
        with tempfile.TemporaryDirectory() as apart:
            finger = replace(made.finger, max_kpa=float(found_kpa[k]))
            once, *_ = cache.simulate(finger, fem, Observation(1, made.observation.points), Path(apart))
        place = once.domain.tip_mm + once.displacements[-1, once.domain.base[-1]]
        print(f"solved at {found_kpa[k]:.4f} kPa: the tip misses its target by "
              f"{np.linalg.norm(place - there(asked_kpa[k])):.1e} mm")  # fmt: skip


if __name__ == "__main__":
    main()
