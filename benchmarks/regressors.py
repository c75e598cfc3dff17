"""What standard regressors make of the same training points, beside the lab's models that are fitted in seconds.

    python benchmarks/regressors.py [finger ...]

Trees and thin-plate splines are compared here alone; the Gaussian process is a model of the lab. Snapshots of a finger
are taken from the cache, or simulated; the split is `random`.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from sklearn.ensemble import ExtraTreesRegressor

from benchmarks.common import parsed, parser
from benchmarks.scenes import scene, simulated, unseen_of
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.data import Training

Floats = NDArray[np.float64]
Rule = Callable[[Training, Dataset], Floats]

MODES = 12  # eigenfunctions of the body that stand for the place, where (x, z) does not tell chambers apart
EVERY = 20  # every 20th snapshot is predicted: local interpolation of all takes minutes


def _plane(training: Training, snapshots: Dataset) -> tuple[Floats, list[Floats]]:
    """Training inputs (n, 3), and those (N, 3) of every predicted snapshot."""
    samples = training.whole
    return _inputs(snapshots, snapshots.domain.points_mm, samples.points_mm, samples.pressures_kpa)


def _body(training: Training, snapshots: Dataset) -> tuple[Floats, list[Floats]]:
    """The same with the body's Laplace eigenfunctions in place of x and z, the slow ones weighing more."""
    from pgdl_lab.surrogate.triangulation import Triangulation

    body = Triangulation(snapshots.domain.points_mm, snapshots.domain.cells)
    modes, values = body.modes(MODES)
    modes = modes * np.sqrt(values[0] / values)
    corners, weights = body.locate(training.whole.points_mm)
    return _inputs(snapshots, modes, np.einsum("nc,ncm->nm", weights, modes[corners]), training.whole.pressures_kpa)


def _inputs(snapshots: Dataset, place: Floats, trained: Floats, kpa: Floats) -> tuple[Floats, list[Floats]]:
    size, highest = place.std(axis=0).max(), snapshots.pressures_kpa[-1] / 2
    return np.column_stack([trained / size, kpa / highest]), [
        np.column_stack([place / size, np.full(len(place), p / highest)])
        for p in snapshots.pressures_kpa[EVERY - 1 :: EVERY]
    ]


def _fitted(inputs: Callable[..., tuple[Floats, list[Floats]]], regressor: Any) -> Rule:
    """`regressor`, of scikit-learn, on `inputs`."""

    def rule(training: Training, snapshots: Dataset) -> Floats:
        trained, asked = inputs(training, snapshots)
        regressor.fit(trained, training.whole.displacements_mm)
        return np.stack([regressor.predict(each) for each in asked])

    return rule


def _rbf(training: Training, snapshots: Dataset) -> Floats:
    trained, asked = _plane(training, snapshots)
    interpolant = RBFInterpolator(trained, training.whole.displacements_mm, neighbors=50)
    return np.stack([interpolant(each) for each in asked])


def _ours(name: str) -> Rule:
    def rule(training: Training, snapshots: Dataset) -> Floats:
        surrogate = plugin("model", name)().fit(training)
        return np.asarray(surrogate.predict(snapshots.domain.points_mm, snapshots.pressures_kpa[EVERY - 1 :: EVERY]))

    return rule


RULES: dict[str, Rule] = {
    "trees on x, z, p": _fitted(_plane, ExtraTreesRegressor(100, random_state=0)),
    "trees on eigenfunctions, p": _fitted(_body, ExtraTreesRegressor(100, random_state=0)),
    "thin-plate RBF, 50 neighbours": _rbf,
    "gaussian_process": _ours("gaussian_process"),
    "finite_element": _ours("finite_element"),
    "pod": _ours("pod"),
}


def main() -> None:
    """Print a table of errors over unseen points and of the time for training and five predicted snapshots."""
    arguments = parser(__doc__)
    arguments.add_argument("fingers", nargs="*", default=["pneunet"])
    given = parsed(arguments)
    print(f"{'finger':<9}{'method':<62}{'MSE x [mm²]':>12}{'MSE z [mm²]':>12}{'time [s]':>10}")
    for name in given.fingers:
        made = scene(name, quick=given.quick)
        snapshots = simulated(made)
        train = made.split.train_points(snapshots, 0)
        unseen = unseen_of(snapshots, train)
        training = made.training(snapshots, train, Path())
        for title, rule in RULES.items():
            start = time.perf_counter()
            predicted = rule(training, snapshots)
            seconds = time.perf_counter() - start
            error = predicted - snapshots.displacements[EVERY - 1 :: EVERY]
            x, z = (error[unseen[EVERY - 1 :: EVERY]] ** 2).mean(axis=0)
            print(f"{name:<9}{title:<62}{x:>12.1e}{z:>12.1e}{seconds:>10.1f}", flush=True)


if __name__ == "__main__":
    main()
