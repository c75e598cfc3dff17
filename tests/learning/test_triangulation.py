import numpy as np
import pytest

from pgdl_lab.surrogate.triangulation import Triangulation
from tests.synthetic import comb


def rectangle(cells: int = 24) -> Triangulation:
    """A rectangle of 2 mm × 1 mm."""
    x, z = np.meshgrid(np.linspace(0, 2, cells + 1), np.linspace(0, 1, cells + 1), indexing="ij")
    grid = np.arange(x.size).reshape(x.shape)
    corners = grid[:-1, :-1].ravel(), grid[1:, :-1].ravel(), grid[1:, 1:].ravel(), grid[:-1, 1:].ravel()
    triangles = np.concatenate([np.stack([corners[i] for i in pick], axis=1) for pick in ((0, 1, 2), (0, 2, 3))])
    return Triangulation(np.stack([x.ravel(), z.ravel()], axis=1), triangles)


def test_modes_of_a_rectangle_are_cosines() -> None:
    functions, eigenvalues = rectangle().modes(3)
    assert eigenvalues == pytest.approx(np.pi**2 * np.array([1 / 4, 1, 1]), rel=1e-2)
    first = np.sqrt(2) * np.cos(np.pi * rectangle().points_mm[:, 0] / 2)
    assert np.abs(np.abs(functions[:, 0]) - np.abs(first)).max() < 5e-3


def test_modes_repeat_exactly() -> None:
    body = Triangulation(*comb(3.0))
    assert np.array_equal(body.modes(10)[0], body.modes(10)[0])


def test_derivatives_of_a_quadratic_are_exact() -> None:
    body = Triangulation(*comb(2.0))
    x, z = body.points_mm.T
    values = 1 + 2 * x - z + 0.5 * x**2 - 3 * z**2 + 4 * x * z
    expected = [2 + x + 4 * z, -1 - 6 * z + 4 * x, np.ones_like(x), -6 * np.ones_like(x), 4 * np.ones_like(x)]
    for matrix, derivative in zip(body.derivatives, expected, strict=True):
        assert matrix @ values == pytest.approx(derivative, abs=1e-8)


def test_linear_functions_have_no_kinks() -> None:
    body = rectangle(24)
    x, z = body.points_mm.T
    assert np.abs(body.kinks @ (3 + 2 * x - z)).max() < 1e-10


@pytest.mark.parametrize("power", [(2, 0), (0, 2), (1, 1)])
def test_squared_kinks_add_up_to_an_integral_of_squared_second_derivatives(power: tuple[int, int]) -> None:
    def energy(cells: int) -> float:
        x, z = rectangle(cells).points_mm.T
        return float(((rectangle(cells).kinks @ (x ** power[0] * z ** power[1])) ** 2).sum())

    # by how much flat triangles are stiffer than a plate depends on their shape, but not on their size
    assert energy(24) > 2.0 * 2  # 2 mm² with |∇²u|² of at least 2
    assert energy(48) == pytest.approx(energy(24), rel=0.05)


def test_kinks_do_not_act_across_a_slot() -> None:
    body = Triangulation(*comb(2.5))
    tooth = (body.points_mm[:, 0] < 11) & (body.points_mm[:, 1] > 8)
    beyond = (body.points_mm[:, 0] > 11) & (body.points_mm[:, 1] > 8)
    assert tooth.any() and not (body.kinks[:, tooth].T @ body.kinks)[:, beyond].nnz


def test_kink_of_two_triangles_by_hand() -> None:
    """A rectangle of 2 mm × 1 mm and its diagonal: u = x/2 − z on one side, whose normal derivative is −2.5/√5, 0 on
    the other; the diagonal is √5 mm long, and a third of both triangles of 1 mm² belongs to it.
    """
    points = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    body = Triangulation(points, np.array([[0, 1, 2], [0, 2, 3]]))
    kink = 2.5 / np.sqrt(5) * np.sqrt(5) / np.sqrt(2 / 3)
    assert body.kinks.shape == (1, 4)
    # zero for all linear functions, so that the corners off the diagonal count alike and those on it the other way
    assert np.abs(body.kinks.toarray()[0]) == pytest.approx(np.array([1, 1, 1, 1]) * kink)
    assert body.kinks.toarray()[0] * np.sign(body.kinks[0, 1]) == pytest.approx(np.array([-1, 1, -1, 1]) * kink)


def test_ring_of_three_points_is_their_triangle() -> None:
    points = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [1.0, 1.0]])
    inner, corners, weights = Triangulation(points, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])).rings
    assert inner.tolist() == [3] and sorted(corners[0]) == [0, 1, 2]
    assert weights[0] == pytest.approx(1 / 3)


def test_ring_of_many_points_is_its_nearest_triangle() -> None:
    """Six points around one, three of them twice as far away; the far triangle comes first."""
    angle = np.pi / 3 * np.arange(6)
    radius = np.array([2.0, 1.0, 2.0, 1.0, 2.0, 1.0])
    around = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    order = [0, 2, 4, 1, 3, 5]
    number = np.argsort(order)  # of each point of the circle in `points`
    points = np.concatenate([around[order], [[0.0, 0.0]]])
    fan = np.stack([number, np.roll(number, -1), np.full(6, 6)], axis=1)
    inner, corners, weights = Triangulation(points, fan).rings
    found = dict(zip(inner.tolist(), corners, strict=True))
    assert sorted(found[6]) == [3, 4, 5]
    assert weights[inner == 6][0] == pytest.approx(1 / 3)
