"""A surrogate of modes on a triangulated body, whose amplitudes are polynomials in the pressure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.learning.interpolation import interpolation_bars
from pgdl_lab.learning.separable import chebyshev
from pgdl_lab.learning.triangulation import Triangulation
from pgdl_lab.model import Model
from pgdl_lab.surrogate import Record, Surrogate

AT_NODE = 1e-9  # weight of other nodes below which a point is one

Floats = NDArray[np.float64]


class NodalSurrogate(Surrogate):
    """u(x, p) = Σ modes(x) · amplitudes(p), linear between the nodes of the body.

    Error bars are those of the values at the nodes and, between nodes, of linear interpolation, which is the greater
    part of the error there; see `interpolation_bars`.

    What was looked up for the points asked for last is kept, as control loops ask for the same ones.

    Parameters
    ----------
    model, record
        See `Surrogate`.
    state
        "points_mm" (N, 2) and "triangles" (T, 3), the undeformed body; "modes" (N, K, 2); "amplitudes" (D, K) [mm],
        Chebyshev coefficients of the amplitudes of the K modes; "range_kpa" (2,), pressures mapped to −1 … 1. With
        error bars also "spread" (N, K, K), square roots of the modes' covariance at the nodes; "noise_mm" (); "bar_kpa"
        (B,) and "bar_deviations" (B,), pressures and the number of standard deviations that make a bar there.
    """

    def __init__(self, model: Model, record: Record, state: Mapping[str, Tensor]) -> None:
        super().__init__(model, record)
        self._state = dict(state)
        self._arrays = {name: tensor.numpy() for name, tensor in state.items()}
        self._body = Triangulation(self._arrays["points_mm"], self._arrays["triangles"])
        self._degree = len(self._arrays["amplitudes"]) - 1
        self._points = np.full((1, 2), np.nan)  # equal to no points
        self._modes = np.empty(0)

    def state(self) -> dict[str, Tensor]:
        return self._state

    def displacements(self, points_mm: Floats, pressures_kpa: Floats) -> Floats:
        if not np.array_equal(points_mm, self._points):
            corners, weights = self._body.locate(points_mm)
            modes = np.einsum("nc,ncki->kni", weights, self._arrays["modes"][corners])
            self._modes = np.ascontiguousarray(modes.reshape(len(modes), -1))
            self._points = points_mm.copy()
        return (self._amplitudes(pressures_kpa) @ self._modes).reshape(len(pressures_kpa), len(points_mm), 2)

    def bars(self, points_mm: Floats, pressures_kpa: Floats) -> Floats | None:
        if "spread" not in self._arrays:
            return None
        corners, weights = self._body.locate(points_mm)
        roots = np.tensordot(self._amplitudes(pressures_kpa), self._arrays["spread"], axes=(1, 1))  # (P, N, K)
        nodal_mm = np.sqrt((roots**2).sum(axis=2) + self._arrays["noise_mm"] ** 2)
        # the deviation of a mean of three is at most the mean of the three
        deviation_mm = np.einsum("nc,pnc->pn", weights, nodal_mm[:, corners])
        factor = np.interp(pressures_kpa, self._arrays["bar_kpa"], self._arrays["bar_deviations"])
        bars_mm = factor[:, None] * deviation_mm
        between = weights.max(axis=1) < 1 - AT_NODE
        if between.any():
            nodal = np.einsum("pk,nkc->pnc", self._amplitudes(pressures_kpa), self._arrays["modes"])
            more_mm = interpolation_bars(self._body, nodal, points_mm[between])
            bars_mm[:, between] = np.hypot(bars_mm[:, between], more_mm)
        return bars_mm

    def _amplitudes(self, pressures_kpa: Floats) -> Floats:
        """Amplitudes (P, K) of the modes [mm]."""
        return chebyshev(pressures_kpa, self._arrays["range_kpa"], self._degree) @ self._arrays["amplitudes"]
