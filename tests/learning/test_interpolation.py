"""Bars of linear interpolation, on fields that are known between the nodes too."""

import numpy as np
import pytest

from pgdl_lab.surrogate.interpolation import interpolation_bars
from pgdl_lab.surrogate.triangulation import Triangulation
from tests.learning.test_triangulation import rectangle

PLACES = np.random.default_rng(0).uniform([0, 0], [2, 1], (400, 2))


def interpolated(body: Triangulation, nodal: np.ndarray) -> np.ndarray:
    corners, weights = body.locate(PLACES)
    return np.einsum("mk,pmkc->pmc", weights, nodal[:, corners])


def waves(points: np.ndarray) -> np.ndarray:
    """Two fields (2, N, 2) of different wave lengths."""
    x, z = points.T
    return np.stack([np.stack([np.sin(x / s) * np.cos(z / s), np.cos(x / s - 3 * z)], axis=1) for s in (0.2, 0.5)])


def test_bars_cover_as_many_errors_as_they_say() -> None:
    body = rectangle()
    nodal = waves(body.points_mm)
    error = np.abs(interpolated(body, nodal) - waves(PLACES))
    bars = interpolation_bars(body, nodal, PLACES)
    covered = (error <= bars[..., None]).mean(axis=(1, 2))
    assert (covered > 0.9).all()
    # and are not wide for nothing
    assert (np.median(bars, axis=1) < 6 * np.median(error, axis=(1, 2))).all()


def test_bars_vanish_at_the_nodes_and_for_linear_fields() -> None:
    body = rectangle()
    assert interpolation_bars(body, waves(body.points_mm), body.points_mm).max() < 1e-12
    linear = body.points_mm[None] @ np.array([[1.0, 2.0], [3.0, -1.0]])
    assert interpolation_bars(body, linear, PLACES).max() < 1e-9  # mm, of 8


def test_points_lie_within_their_rings() -> None:
    body = rectangle()
    points, corners, weights = body.rings
    assert np.allclose(np.einsum("mk,mkc->mc", weights, body.points_mm[corners]), body.points_mm[points])
    assert weights.min() > -1e-9 and (corners != points[:, None]).all()
    inside = ((body.points_mm > 0) & (body.points_mm < body.points_mm.max(axis=0))).all(axis=1)
    assert np.isin(np.flatnonzero(inside), points).all()


@pytest.mark.parametrize("curved", [(3.0, 1.0, 0.0), (0.5, 4.0, 0.0), (0.0, 0.0, 2.0)])
def test_bars_of_a_quadratic_are_its_errors(curved: tuple[float, float, float]) -> None:
    """Of a x² + b z² the errors along x and along z have one sign; those of c x z stand alone."""
    grid, (a, b, c) = rectangle(), curved
    inside = ((grid.points_mm > 0) & (grid.points_mm < [2, 1])).all(axis=1)
    shift = np.random.default_rng(1).uniform(-0.008, 0.008, grid.points_mm.shape)  # mm, of cells of 0.083 by 0.042
    body = Triangulation(grid.points_mm + inside[:, None] * shift, grid.simplices)  # no edge along x or z

    def field(points: np.ndarray) -> np.ndarray:
        x, z = points.T
        value = a * x**2 + b * z**2 + c * x * z
        return np.stack([value, value], axis=1)[None]

    nodal = field(body.points_mm)
    error = np.abs(interpolated(body, nodal) - field(PLACES))[..., 0]
    np.testing.assert_allclose(interpolation_bars(body, nodal, PLACES), error, rtol=1e-6, atol=1e-9)
