"""A Gaussian process on the body's eigenfunctions and the inputs, fitted by scikit-learn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.inputs import PRESSURE
from pgdl_lab.learning.clock import Clock
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.gaps import Gap, calibrated
from pgdl_lab.surrogate.calibration import Held
from pgdl_lab.surrogate.process_surrogate import covariance, factor, interpolated
from pgdl_lab.surrogate.triangulation import Triangulation

Floats = NDArray[np.float64]

SIZES, LENGTHS, NOISES = (1e-3, 1e6), (1e-2, 1e3), (1e-12, 1.0)  # searched: variance, length scale, noise's variance
JITTER = 1e-10  # least variance of the noise, by that of the process: keeps the matrix positive definite


def fitted(
    body: Triangulation, samples: Samples, modes: int, points: int, rng: np.random.Generator, clock: Clock
) -> dict[str, NDArray[Any]]:
    """The state of a `ProcessSurrogate`.

    Parameters
    ----------
    body
        The triangulated body.
    samples
        The data.
    modes
        Number of eigenfunctions of the body that stand for the place, at most a quarter of its points.
    points
        Number of samples that are learnt from, at most.
    rng
        Chooses them.
    clock
        The search for the likeliest process ends with its budget.
    """
    functions, values = body.modes(min(modes, len(body.points_mm) // 4))
    places = functions * np.sqrt(values[0] / values)  # the slow ones weigh more
    places /= places.std(axis=0).max()
    halves = np.array(
        [(high - (0.0 if name == PRESSURE else low)) / 2 for name, (low, high) in samples.cases.ranges().items()]
    )
    inputs = np.column_stack([interpolated(body, places, samples.points_mm), samples.cases.values / halves])
    mean_mm, size_mm = samples.displacements_mm.mean(axis=0), samples.displacements_mm.std(axis=0)
    size_mm = np.where(size_mm > 0, size_mm, 1.0)
    moved_mm = samples.displacements_mm - mean_mm

    def chosen(those: Held) -> NDArray[np.int64]:
        among = np.flatnonzero(those)
        return rng.choice(among, min(points, len(among)), replace=False)

    learnt = chosen(np.ones(len(inputs), dtype=bool))
    size, length, noise = _kernel(inputs[learnt], moved_mm[learnt] / size_mm, clock)
    inputs /= length

    def weights_mm(part: NDArray[np.int64], lower: Floats) -> Floats:
        weights: Any = np.linalg.solve(lower.T, np.linalg.solve(lower, moved_mm[part]))
        return weights

    def ratios(held: Held, judged: Held) -> Floats:
        part = chosen(~held)
        lower = factor(inputs[part], noise)
        learnt_mm, found = weights_mm(part, lower), []
        judged_at = np.flatnonzero(judged)
        for asked in np.array_split(judged_at, -(-len(judged_at) // points)):
            across = covariance(inputs[asked], inputs[part])
            variance = 1 + noise - (np.linalg.solve(lower, across.T) ** 2).sum(axis=0)
            expected_mm = size * size_mm.max() * np.sqrt(np.maximum(variance, noise))
            found.append(np.abs(across @ learnt_mm - moved_mm[asked]) / expected_mm[:, None])
        return np.concatenate(found)

    gap = Gap.left_by(samples.points_mm, body.points_mm, body.points_mm[:0])
    return {
        "points_mm": body.points_mm,
        "triangles": body.simplices,
        "places": places / length,
        **({"unit_kpa": halves[0] * length} if len(halves) == 1 else {"units": halves * length}),
        "inputs": inputs[learnt],
        "weights_mm": weights_mm(learnt, factor(inputs[learnt], noise)),
        "mean_mm": mean_mm,
        "size_mm": np.array(size * size_mm.max()),
        "noise": np.array(noise),
        **calibrated(samples, ratios, gap, rng),
    }


def _kernel(inputs: Floats, targets: Floats, clock: Clock) -> tuple[float, float, float]:
    """Standard deviation and length scale of the likeliest process, and variance of the noise by that of the process.

    Parameters
    ----------
    inputs, targets
        (n, D) and (n, 2), of mean 0 and standard deviation 1.
    clock
        The time budget.
    """
    from scipy.optimize import minimize
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    guess = ConstantKernel(1.0, SIZES) * RBF(1.0, LENGTHS) + WhiteKernel(1e-4, NOISES)

    def search(objective: Any, start: Floats, bounds: Floats) -> tuple[Floats, float]:
        """That of scikit-learn, but for its end."""
        result = minimize(objective, start, method="L-BFGS-B", jac=True, bounds=bounds, callback=stop)
        return result.x, result.fun

    def stop(intermediate_result: Any) -> None:
        if not clock.left_s:
            raise StopIteration

    found = GaussianProcessRegressor(guess, optimizer=search).fit(inputs, targets).kernel_
    variance = float(found.k1.k1.constant_value)
    return np.sqrt(variance), float(found.k1.k2.length_scale), max(float(found.k2.noise_level) / variance, JITTER)
