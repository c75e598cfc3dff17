"""How long one prediction takes on the CPU."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pgdl_lab.learning.threads import threads
from pgdl_lab.surrogate.surrogate import Surrogate

LEAST_REPEATS = 100  # so that the 99th percentile is a measured one
SECONDS = 0.5


def latency_ms(surrogate: Surrogate, points_mm: NDArray[np.float64], tip: int, kpa: float) -> dict[str, Any]:
    """Latency of predictions at one pressure: median and 99th percentile [ms].

    Parameters
    ----------
    surrogate
        What is timed; NumPy in, NumPy out.
    points_mm
        (N, 2), all points of the face [mm].
    tip
        Index of the tip point.
    kpa
        The pressure [kPa].

    Returns
    -------
    "full_field" and "tip" on one thread, and both on all threads under "all_threads" with the number of "threads".
    """
    available = torch.get_num_threads()

    def both() -> dict[str, dict[str, float]]:
        return {
            "full_field": _percentiles(lambda: surrogate.predict(points_mm, kpa, beyond=True)),
            "tip": _percentiles(lambda: surrogate.predict(points_mm[tip : tip + 1], kpa, beyond=True)),
        }

    with threads(1):
        single = both()
    return {**single, "all_threads": {"threads": available, **both()}}


def median_ms(predict: Callable[[], object]) -> float:
    """Median time of a prediction on one thread [ms]."""
    with threads(1):
        return _percentiles(predict)["median"]


def _percentiles(predict: Callable[[], object]) -> dict[str, float]:
    predict()  # the first call fills caches
    times: list[float] = []
    end = time.perf_counter() + SECONDS
    while len(times) < LEAST_REPEATS or time.perf_counter() < end:
        start = time.perf_counter()
        predict()
        times.append(1e3 * (time.perf_counter() - start))
    return {"median": float(np.median(times)), "p99": float(np.percentile(times, 99))}
