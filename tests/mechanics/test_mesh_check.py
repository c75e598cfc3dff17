"""What elements must keep, at each corner and at each facet of a brick and of a tetrahedron."""

from itertools import combinations, product

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshHex

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.meshcheck import _spans, require_connected, require_sound, right_handed

BRICK = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0], [0, 0, 4], [1, 0, 4], [1, 2, 4], [0, 2, 4]], dtype=float)
CORNER = np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 2]], dtype=float)
FACES_OF_BRICK = [np.flatnonzero(BRICK[:, i] == value) for i in range(3) for value in (0, BRICK[:, i].max())]
FACES_OF_TETRAHEDRON = [np.array(face) for face in combinations(range(4), 3)]


def test_volume_at_each_corner_over_the_cube_of_the_longest_edge() -> None:
    assert _spans(BRICK, np.arange(8)[None]) == pytest.approx(np.full((1, 8), 1 * 2 * 4 / 4**3))
    assert _spans(CORNER, np.arange(4)[None]) == pytest.approx(np.full((1, 4), 3 * 4 * 2 / 5**3))


@pytest.mark.parametrize(("corner", "share"), list(product(range(8), (0.99, 1.01))))
def test_a_brick_is_refused_once_one_corner_is_pressed_into_it(corner: int, share: float) -> None:
    """Up to the plane through the three corners next to it, a third of the way to the opposite one."""
    inwards = (BRICK.max(axis=0) - 2 * BRICK[corner]) / 3
    points = BRICK.copy()
    points[corner] += share * inwards
    assert right_handed(BRICK, np.arange(8)[None], "brick")[1] is False
    if share < 1:
        right_handed(points, np.arange(8)[None], "brick")
    else:
        # beside two sound ones, else it would be the rest that is inverted against it
        both, elements = np.concatenate([BRICK, points]), np.stack([np.arange(8), np.arange(8), 8 + np.arange(8)])
        with pytest.raises(InputError, match="1 of 3 elements of brick are inverted against the rest or flat"):
            right_handed(both, elements, "brick")


@pytest.mark.parametrize("points", [BRICK, CORNER], ids=["brick", "tetrahedron"])
def test_elements_that_are_all_inverted_are_turned_round(points: NDArray[np.float64]) -> None:
    order = np.arange(len(points))[None]
    turned, reversed_all = right_handed(points * [1, 1, -1], order, "mirrored")
    assert reversed_all and (_spans(points * [1, 1, -1], turned) > 0).all()
    assert sorted(turned[0]) == list(range(len(points)))


@pytest.mark.parametrize(
    ("points", "face"),
    [(BRICK, face) for face in FACES_OF_BRICK] + [(CORNER, face) for face in FACES_OF_TETRAHEDRON],
)
def test_three_elements_at_one_facet_are_refused(points: NDArray[np.float64], face: NDArray[np.int64]) -> None:
    count = len(points)
    elements = [np.arange(count)]
    places = [points]
    for number in (1, 2):
        own = number * count + np.arange(count)
        elements.append(np.where(np.isin(np.arange(count), face), np.arange(count), own))
        places.append(points + 10.0 * number)
    everywhere = np.concatenate(places)
    require_sound(everywhere, np.array(elements[:2]), "pair")
    where = ", ".join(f"{value:.4g}" for value in points[face].mean(axis=0))
    with pytest.raises(InputError, match=rf"1 facets of three belong to more than two elements.*\({where}\)"):
        require_sound(everywhere, np.array(elements), "three")


def test_the_smallest_piece_is_named() -> None:
    """Of a bar of three bricks and one brick beside it; axes of the file are those of the mesh turned round."""
    bar = MeshHex.init_tensor(np.array([0.0, 1, 2, 3]), np.array([0.0, 1]), np.array([0.0, 1]))
    alone = MeshHex().translated([10.0, 20.0, 30.0])
    both = MeshHex(np.hstack([bar.p, alone.p]), np.hstack([bar.t, alone.t + bar.p.shape[1]]))
    turned = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # x of the mesh is y of the file
    with pytest.raises(InputError, match=r"two.vtu form 2 pieces .* near \(30\.5, 10\.5, 20\.5\) mm"):
        require_connected(both, "two.vtu", turned)
    require_connected(bar, "one.vtu", turned)
