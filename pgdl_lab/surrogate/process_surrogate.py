"""The surrogate of a Gaussian process; NumPy is all it needs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.simplices import SimplexMesh
from pgdl_lab.surrogate.probe import Case, Probe
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.shapes import FLOATS, INDICES
from pgdl_lab.surrogate.surrogate import Surrogate

Floats = NDArray[np.float64]

MOST_POINTS = 5000  # to learn from: the covariance of so many takes 0.2 GB


class ProcessSurrogate(Surrogate):
    """The mean of a Gaussian process whose covariance is that of squared distances in all inputs together.

    Parameters
    ----------
    model, record
        See `Surrogate`.
    state
        "points_mm" (N, d) and "triangles" (T, d + 1), the undeformed body, in space of tetrahedra; "places" (N, M), the
        inputs that stand for its points; "unit_kpa" (), pressure per unit of the last input, or "units" (D,), that of
        each of the last D; all by the length scale. "inputs" (n, M + D), of the points learnt from, with "weights_mm"
        (n, d), and "mean_mm" (d,). "size_mm" (), standard deviation of the process, and "noise" (), variance of the
        noise by that of the process. With error bars "bar_kpa" (B,) and "bar_deviations" (B,), how far along, see
        `limits.along`, and the number of standard deviations that make a bar there, and where the body has a stretch
        without training points "bar_stretch" (N,), how many times wider bars are.
    """

    shapes = {
        "points_mm": (FLOATS, "N", "d"),
        "triangles": (INDICES, "T", "c"),
        "places": (FLOATS, "N", "M"),
        "unit_kpa": (FLOATS,),
        "units": (FLOATS, "D"),
        "inputs": (FLOATS, "n", "I"),
        "weights_mm": (FLOATS, "n", "d"),
        "mean_mm": (FLOATS, "d"),
        "size_mm": (FLOATS,),
        "noise": (FLOATS,),
        "bar_kpa": (FLOATS, "B"),
        "bar_deviations": (FLOATS, "B"),
        "bar_stretch": (FLOATS, "N"),
    }

    def __init__(self, model: Mapping[str, Any], record: Record, state: Mapping[str, NDArray[Any]]) -> None:
        super().__init__(model, record)
        if len(state["inputs"]) > MOST_POINTS:
            raise ValueError(f"it learnt from {len(state['inputs']):,} points, and {MOST_POINTS:,} are allowed")
        known = state["units"] if "units" in state else state["unit_kpa"][None]
        if len(known) != len(self.inputs) or state["inputs"].shape[1] != state["places"].shape[1] + len(known):
            raise ValueError(f"inputs is {state['inputs'].shape}")
        self._state = dict(state)
        self._body = SimplexMesh(state["points_mm"], state["triangles"])

    def state(self) -> dict[str, NDArray[Any]]:
        return self._state

    def probe(self, points_mm: Floats) -> ProcessProbe:
        places = interpolated(self._body, self._state["places"], points_mm)
        return ProcessProbe(self._state, covariance(places, self._state["inputs"][:, : places.shape[1]]))

    def bars(self, points_mm: Floats, cases: Floats) -> Floats | None:
        state = self._state
        if "bar_deviations" not in state:
            return None
        probe = self.probe(points_mm)
        known = np.empty((len(cases), len(points_mm)))
        for row, case in zip(known, cases, strict=True):
            by_case, _ = probe.along(case)
            row[:] = ((probe.by_place @ (by_case * self._inverse_factor.T)) ** 2).sum(axis=1)
        deviation_mm = state["size_mm"] * np.sqrt(np.maximum(1 + state["noise"] - known, state["noise"]))
        bars_mm: Floats = (
            np.interp(self.along(cases), state["bar_kpa"], state["bar_deviations"])[:, None] * deviation_mm
        )
        if "bar_stretch" in state:
            bars_mm *= interpolated(self._body, state["bar_stretch"][:, None], points_mm)[:, 0]
        return bars_mm

    @cached_property
    def _inverse_factor(self) -> Floats:
        """L⁻¹ (n, n) of the covariance L Lᵀ of the points learnt from, with the noise."""
        inverse: Any = np.linalg.inv(factor(self._state["inputs"], float(self._state["noise"])))
        return inverse


class ProcessProbe(Probe):
    """The process at fixed points, whose covariance (N, n) by the place is kept."""

    def __init__(self, state: Mapping[str, NDArray[Any]], by_place: Floats) -> None:
        self._state, self.by_place = state, by_place
        self._units = state["units"] if "units" in state else state["unit_kpa"][None]
        self._known = np.ascontiguousarray(state["inputs"][:, -len(self._units) :])

    def value(self, case: Case) -> Floats:
        by_case, _ = self.along(case)
        return self.by_place @ (by_case * self._state["weights_mm"]) + self._state["mean_mm"]

    def slope(self, case: Case) -> Floats:
        by_case, offsets = self.along(case)
        columns = [
            self.by_place @ (-offset[:, None] * by_case * self._state["weights_mm"]) / unit
            for offset, unit in zip(offsets.T, self._units, strict=True)
        ]
        return np.stack(columns, axis=-1) if np.ndim(case) else columns[0]

    def along(self, case: Case) -> tuple[Floats, Floats]:
        """Covariance (n, 1) by the inputs, and their distances (n, D) from those of each point learnt from."""
        offsets = case / self._units - self._known
        squares = offsets**2
        if len(self._units) > 1:
            squares = squares.sum(axis=1, keepdims=True)
        return np.exp(-squares / 2), offsets


def interpolated(body: SimplexMesh, nodal: Floats, points_mm: Floats) -> Floats:
    """Values (m, M) at points (m, d) [mm] of those at the nodes (N, M)."""
    corners, weights = body.locate(points_mm)
    return np.einsum("nc,ncm->nm", weights, nodal[corners])


def covariance(inputs: Floats, others: Floats) -> Floats:
    """exp(−|a − b|² / 2) of inputs a (m, D) and b (n, D)."""
    squares = (inputs**2).sum(axis=1)[:, None] + (others**2).sum(axis=1) - 2 * inputs @ others.T
    return np.exp(-np.maximum(squares, 0) / 2)


def factor(inputs: Floats, noise: float) -> Floats:
    """Cholesky factor (n, n) of the covariance of inputs (n, D) and of noise of this variance."""
    lower: Any = np.linalg.cholesky(covariance(inputs, inputs) + noise * np.eye(len(inputs)))
    return lower
