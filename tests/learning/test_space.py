"""What models learn on tetrahedra, against closed forms."""

from itertools import permutations

import numpy as np
import pytest

from pgdl_lab.surrogate.interpolation import interpolation_bars
from pgdl_lab.surrogate.triangulation import Triangulation


def box(cells: int = 6, size: tuple[float, float, float] = (2.0, 1.0, 1.0)) -> Triangulation:
    """A box of cells³ cells, each of six tetrahedra."""
    axes = [np.linspace(0, length, cells + 1) for length in size]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = np.arange(len(points)).reshape([cells + 1] * 3)
    tetrahedra = []
    for first, second, _ in permutations(range(3)):  # from corner to corner along the three axes, in any order
        steps = np.zeros((4, 3), dtype=int)
        steps[1:, first], steps[2:, second], steps[3] = 1, 1, 1
        parts = [grid[tuple(slice(step, cells + step) for step in way)].ravel() for way in steps]
        tetrahedra.append(np.stack(parts, axis=1))
    return Triangulation(points, np.concatenate(tetrahedra))


def test_modes_of_a_box_are_cosines() -> None:
    body = box(10)
    functions, eigenvalues = body.modes(3)
    assert eigenvalues[0] == pytest.approx(np.pi**2 / 4, rel=2e-2)
    first = np.sqrt(2) * np.cos(np.pi * body.points_mm[:, 0] / 2)
    assert np.abs(np.abs(functions[:, 0]) - np.abs(first)).max() < 4e-2


def test_derivatives_of_a_quadratic_are_exact() -> None:
    body = box(4)
    x, y, z = body.points_mm.T
    values = 1 + 2 * x - z + 0.5 * x**2 - 3 * z**2 + y**2 + 4 * x * y - x * z + 7 * y * z
    one = np.ones_like(x)
    expected = [
        2 + x + 4 * y - z, 2 * y + 4 * x + 7 * z, -1 - 6 * z - x + 7 * y,
        one, 2 * one, -6 * one, 4 * one, -one, 7 * one,
    ]  # fmt: skip
    for matrix, derivative in zip(body.derivatives, expected, strict=True):
        assert matrix @ values == pytest.approx(derivative, abs=1e-9)


def test_linear_functions_have_no_kinks() -> None:
    body = box(3)
    assert body.kinks.shape[0] == (4 * 162 - 108) / 2  # facets that two of 162 tetrahedra share
    assert np.abs(body.kinks @ (3 + body.points_mm @ [2.0, -1.0, 0.5])).max() < 1e-12


@pytest.mark.parametrize("turned", [False, True])
def test_kink_of_two_tetrahedra_by_hand(turned: bool) -> None:
    """Two corners of cubes of 1 mm on both sides of their common right-angled triangle of 1/2 mm² at z = 0.

    u is z on one side and 0 on the other: the normal derivative jumps by 1, and a fourth of both volumes of 1/6 mm³
    belongs to the triangle.
    """
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]])
    tetrahedra = np.array([[0, 1, 2, 3], [0, 1, 2, 4]])
    if turned:
        tetrahedra = tetrahedra[:, [1, 0, 2, 3]]
    kinks = Triangulation(points, tetrahedra).kinks
    assert kinks.shape == (1, 5)
    expected = 0.5 / np.sqrt((1 / 6 + 1 / 6) / 4)
    assert np.abs(kinks @ [0.0, 0, 0, 1, 0]) == pytest.approx(expected)
    assert np.abs(kinks @ [0.0, 0, 0, 1, 1]) == pytest.approx(2 * expected)


def test_squared_kinks_do_not_depend_on_the_size_of_the_mesh() -> None:
    def energy(cells: int) -> float:
        x, _, z = box(cells).points_mm.T
        return float(((box(cells).kinks @ (x**2 + x * z)) ** 2).sum())

    assert energy(16) == pytest.approx(energy(8), rel=0.1)


def test_a_point_lies_among_its_neighbours() -> None:
    body = box(4)
    nodes, corners, weights = body.rings
    outer = (body.points_mm == body.points_mm.min(axis=0)) | (body.points_mm == body.points_mm.max(axis=0))
    assert {*np.flatnonzero(~outer.any(axis=1))} <= {*nodes}  # all that lie inside the body
    assert not (corners == nodes[:, None]).any() and weights.min() > -1e-8
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(np.einsum("mc,mci->mi", weights, body.points_mm[corners]), body.points_mm[nodes])


def test_bars_cover_what_linear_interpolation_leaves_out() -> None:
    body = box(8)

    def field(points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        return np.stack([np.sin(2 * x + y), np.cos(x * z), y**2 * x], axis=1)[None]

    rng = np.random.default_rng(0)
    mix = rng.dirichlet(np.ones(4), 1000)
    inside = np.einsum("nc,nci->ni", mix, body.points_mm[body.simplices[rng.integers(len(body.simplices), size=1000)]])
    corners, weights = body.locate(inside)
    error = np.abs(np.einsum("nc,nck->nk", weights, field(body.points_mm)[0][corners]) - field(inside)[0])
    bars = interpolation_bars(body, field(body.points_mm), inside)[0]
    assert (error <= bars[:, None]).mean() > 0.9
    assert np.median(bars) < 12 * np.median(error)
    assert interpolation_bars(body, field(body.points_mm), body.points_mm).max() < 1e-12
