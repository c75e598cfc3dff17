"""A surrogate of modes on a body of triangles or tetrahedra, whose amplitudes are polynomials in the pressure."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.simplices import SimplexMesh
from pgdl_lab.surrogate.basis import SHAPES, Basis
from pgdl_lab.surrogate.probe import BasisProbe, PolynomialProbe, Probe
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.shapes import FLOATS, INDICES
from pgdl_lab.surrogate.surrogate import Surrogate

if TYPE_CHECKING:
    from pgdl_lab.surrogate.triangulation import Triangulation

AT_NODE = 1e-9  # weight of other nodes below which a point is one

Floats = NDArray[np.float64]


class NodalSurrogate(Surrogate):
    """u(x, p) = Σ modes(x) · amplitudes(p), p all inputs, linear between the nodes of the body; NumPy is all it needs.

    Error bars are those of the values at the nodes and, between nodes, of linear interpolation, which is the greater
    part of the error there; see `interpolation_bars`. These need SciPy: without it there are bars at nodes alone.

    Parameters
    ----------
    model, record
        See `Surrogate`.
    state
        "points_mm" (N, d) and "triangles" (T, d + 1), the undeformed body, in space of tetrahedra; "modes" (N, K, d);
        "amplitudes" (D, K) [mm], coefficients of the amplitudes of the K modes in D functions of the inputs: Chebyshev
        polynomials, with "range_kpa" (2,), pressures mapped to −1 … 1, or for several inputs what `Basis.state` says.
        With error bars also "spread" (N, D, L) [mm], square roots of the covariance of the nodes' coefficients;
        "noise_mm" (); "bar_kpa" (B,) and "bar_deviations" (B,), how far along, see `limits.along`, and the number of
        standard deviations that make a bar there; where the body has a stretch without training points "bar_stretch"
        (N,), how many times wider bars are.
    """

    shapes = {
        "points_mm": (FLOATS, "N", "d"),
        "triangles": (INDICES, "T", "c"),
        "modes": (FLOATS, "N", "K", "d"),
        "amplitudes": (FLOATS, "D", "K"),
        **SHAPES,
        "spread": (FLOATS, "N", "D", "L"),
        "noise_mm": (FLOATS,),
        "bar_kpa": (FLOATS, "B"),
        "bar_deviations": (FLOATS, "B"),
        "bar_stretch": (FLOATS, "N"),
    }

    def __init__(self, model: Mapping[str, Any], record: Record, state: Mapping[str, NDArray[Any]]) -> None:
        super().__init__(model, record)
        # sums over arrays in another order would differ in the last bits
        self._state = {name: np.asarray(array, order="C") for name, array in state.items()}
        self._body = SimplexMesh(state["points_mm"], state["triangles"])
        self._basis = Basis.restored(self._state, len(state["amplitudes"]))
        if len(self._basis.ranges) != len(self.inputs):
            raise ValueError(f"it is of {len(self._basis.ranges)} inputs, and trained on {len(self.inputs)}")

    def state(self) -> dict[str, NDArray[Any]]:
        return self._state

    @cached_property
    def _triangulation(self) -> Triangulation:
        from pgdl_lab.surrogate.triangulation import Triangulation

        return Triangulation(self._body.points_mm, self._body.simplices)

    def probe(self, points_mm: Floats) -> Probe:
        corners, weights = self._body.locate(points_mm)
        nodal, share = self._state["modes"], weights[:, :, None, None]
        local = share[:, 0] * nodal[corners[:, 0]]  # (n, K, d); corner by corner, in one order
        for corner in range(1, corners.shape[1]):
            local = local + share[:, corner] * nodal[corners[:, corner]]
        modes, amplitudes_mm = local.transpose(1, 0, 2), self._state["amplitudes"]
        if len(self._basis.ranges) > 1:
            return BasisProbe(modes, amplitudes_mm, self._basis)
        return PolynomialProbe(modes, amplitudes_mm, self._state["range_kpa"])

    def bars(self, points_mm: Floats, cases: Floats) -> Floats | None:
        if "bar_deviations" not in self._state:
            return None
        corners, weights = self._body.locate(points_mm)
        functions = self._basis(cases)
        roots = np.tensordot(functions, self._state["spread"], axes=(1, 1))  # (P, N, L)
        nodal_mm = np.sqrt((roots**2).sum(axis=2) + self._state["noise_mm"] ** 2)
        if "bar_stretch" in self._state:
            nodal_mm *= self._state["bar_stretch"]
        # the deviation of a mean of some is at most the mean of theirs
        deviation_mm = np.einsum("nc,pnc->pn", weights, nodal_mm[:, corners])
        factor = np.interp(self.along(cases), self._state["bar_kpa"], self._state["bar_deviations"])
        bars_mm: Floats = factor[:, None] * deviation_mm
        between = weights.max(axis=1) < 1 - AT_NODE
        if between.any():
            try:
                from pgdl_lab.surrogate.interpolation import interpolation_bars
            except ModuleNotFoundError:  # a robot without SciPy
                return None
            nodal = np.einsum("pk,nkc->pnc", functions @ self._state["amplitudes"], self._state["modes"])
            more_mm = interpolation_bars(self._triangulation, nodal, points_mm[between])
            bars_mm[:, between] = np.hypot(bars_mm[:, between], more_mm)
        return bars_mm
