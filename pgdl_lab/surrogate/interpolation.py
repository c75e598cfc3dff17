"""What linear interpolation between the nodes of a field leaves out, estimated from the field itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.surrogate.calibration import COVERED
from pgdl_lab.surrogate.triangulation import Triangulation, products

Floats = NDArray[np.float64]


def interpolation_bars(body: Triangulation, nodal_mm: Floats, points_mm: Floats) -> Floats:
    """Bars (P, M) [mm] that cover 95 % of the errors of linear interpolation at points (M, d) [mm]; zero at the nodes.

    At a point x with weights λ_k on corners x_k, linear interpolation of a quadratic with second derivatives H errs by
    Σ λ_k (x_k − x)ᵀ H (x_k − x) / 2. Here it is summed up by absolute values, with the largest H that the corners
    show. How many times larger the errors are is found by leaving out one node after the other, and
    interpolating it from those around it.

    Parameters
    ----------
    body
        The triangulated body.
    nodal_mm
        (P, N, k), P fields at the nodes [mm].
    points_mm
        Where bars are wanted.
    """
    d = body.points_mm.shape[1]
    second = np.stack([
        np.sqrt((np.stack([matrix @ field for field in nodal_mm]) ** 2).mean(axis=2)) for matrix in body.derivatives[d:]
    ])  # (H, P, N), root mean square over the components  # fmt: skip

    def expected(places_mm: Floats, corners: NDArray[np.int64], weights: Floats) -> Floats:
        along = list(np.moveaxis(body.points_mm[corners] - places_mm[:, None], 2, 0))
        arms = np.abs(np.stack([(weights * part).sum(axis=1) for part in products(along)]))
        return np.einsum("jm,jpm->pm", arms, second[:, :, corners].max(axis=3))

    left, around, shares = body.rings
    error_mm = np.abs(np.einsum("mk,pmkc->pmc", shares, nodal_mm[:, around]) - nodal_mm[:, left])
    guess_mm = expected(body.points_mm[left], around, shares)[..., None]
    ratio = np.quantile((error_mm / np.maximum(guess_mm, np.finfo(float).tiny)).reshape(len(nodal_mm), -1), COVERED, 1)
    return ratio[:, None] * expected(points_mm, *body.locate(points_mm))
