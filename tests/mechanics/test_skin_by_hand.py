"""Faces of all elements, their bulge, and distances at rest between parts whose nearest places are known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshHex, MeshTet

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.collision import ends
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.elements import ELEMENTS, discretise
from pgdl_lab.mechanics.skin import bulge, faces_of
from tests.fingers import tetrahedra

Array = NDArray[np.float64]


@pytest.mark.parametrize("kind", sorted(ELEMENTS))
def test_nodes_of_a_face_go_round_it_and_its_middles_lie_between(kind: str) -> None:
    block = MeshHex.init_tensor(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]), np.array([0.0, 1.5]))
    block = block.with_boundaries({"all": block.boundary_facets()})
    elements = discretise(block if ELEMENTS[kind].cells == "hexahedra" else tetrahedra(block), ELEMENTS[kind])
    faces = faces_of(elements, elements.basis.mesh.boundary_facets())
    x = elements.positions[faces]
    count = 4 if len(elements.basis.mesh.t) == 8 else 3
    corners = x[:, :count]
    np.testing.assert_allclose(x[:, count : 2 * count], (corners + np.roll(corners, -1, axis=1)) / 2, atol=1e-12)
    if x.shape[1] > 2 * count:
        np.testing.assert_allclose(x[:, -1], corners.mean(axis=1), atol=1e-12)
    from_first = corners - corners[:, :1]
    areas = np.cross(from_first[:, 1:-1], from_first[:, 2:]).sum(axis=1) / 2
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(2 * (3 * 2 + 3 * 1.5 + 2 * 1.5))
    outwards = areas / np.linalg.norm(areas, axis=1, keepdims=True)
    middle = corners.mean(axis=1)
    beyond = middle + 1e-3 * outwards
    assert ((beyond < 0) | (beyond > [3.0, 2.0, 1.5])).any(axis=1).all()


@pytest.mark.parametrize("kind", [name for name in sorted(ELEMENTS) if ELEMENTS[name].cells == "tetrahedra"])
def test_middles_of_all_four_faces_of_one_tetrahedron(kind: str) -> None:
    alone = discretise(
        MeshTet(np.array([[0.0, 3, 0, 0], [0, 0, 4, 0], [0, 0, 0, 2]]), np.arange(4)[:, None]), ELEMENTS[kind]
    )
    x = alone.positions[faces_of(alone, np.arange(4))]
    np.testing.assert_allclose(x[:, 3:6], (x[:, :3] + np.roll(x[:, :3], -1, axis=1)) / 2, atol=1e-12)


def test_bulge_of_a_face_that_is_only_twisted() -> None:
    """z = x y lies ¼ above the flat triangles on its corners, at the middle of the diagonal that they do not share."""
    at = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 1], [0, 0.5], [0.5, 0.5]])
    at = np.column_stack([at, at.prod(axis=1)])
    for nodes in (8, 9):
        assert bulge(np.arange(nodes)[None], at) == pytest.approx(0.25)


def test_vertices_of_a_pair_are_all_but_those_that_it_has_not() -> None:
    pair: Any = SimpleNamespace(vertex_ids=lambda *_: [0, 7, 3, -1])
    mesh: Any = SimpleNamespace(edges=None, faces=None)
    assert ends(pair, mesh).tolist() == [0, 7, 3]


def turned(axis: tuple[float, float, float], angle: float) -> Array:
    """Rotation by `angle` about `axis`, by Rodrigues' formula."""
    n = np.array(axis) / np.linalg.norm(axis)
    k = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    result: Array = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return result


EDGE_ALONG_X, EDGE_ALONG_Y = turned((1, 0, 0), np.pi / 4), turned((0, 1, 0), np.pi / 4)
ON_A_CORNER = turned((1, -1, 0), np.arccos(1 / np.sqrt(3)))
FLAT = np.eye(3)


@pytest.mark.parametrize(
    ("below", "above"),
    [
        (EDGE_ALONG_X, EDGE_ALONG_Y),
        (FLAT, ON_A_CORNER),
        (ON_A_CORNER, FLAT),
        (FLAT, EDGE_ALONG_X),
        (ON_A_CORNER, ON_A_CORNER),  # one above the other, as both diagonals go through the origin
        (FLAT, turned((0, 0, 1), 0.4)),
    ],
    ids=["edge and edge", "face and corner", "corner and face", "face and edge", "corner and corner", "faces"],
)
def test_smallest_distance_at_rest_of_two_cubes(below: Array, above: Array) -> None:
    cube = MeshHex.init_tensor(*3 * [np.linspace(-1, 1, 3)])
    low, high = below @ cube.p, above @ cube.p
    if above is not ON_A_CORNER:
        high[:2] += [[0.13], [0.17]]  # so that edges do not cross in their middles, where samples are
    high[2] += low[2].max() - high[2].min() + 0.08
    both = MeshHex(np.hstack([low, high]), np.hstack([cube.t, cube.t + cube.p.shape[1]]))
    elements = discretise(both, ELEMENTS["hex20"])
    with pytest.raises(InputError, match=r"fem.contact_mm is 0.05 mm; it must be below half of 0.08 mm"):
        Contact(elements, 0.05, 0.05, "on")
    contact = Contact(elements, 0.03, 0.05, "on")
    nearer = np.zeros_like(elements.positions)
    nearer[np.isin(np.arange(len(nearer)), elements.nodes[len(cube.t.T) :]), 2] = -0.05
    assert contact.gap_mm(nearer) == pytest.approx(0.03)


@pytest.mark.parametrize(("cell_mm", "taken"), [(0.25, True), (0.2, True), (0.15, False)])
def test_a_step_of_small_cells_is_taken_while_two_samples_to_an_edge_are_apart(cell_mm: float, taken: bool) -> None:
    """The reach is 0.05 mm: beside the bottom of a step, samples of both walls must be farther than 0.1 mm apart."""
    lines = cell_mm * np.arange(3)
    block = MeshHex.init_tensor(lines, lines, lines)
    centre = block.p[:, block.t].mean(axis=1)
    step = block.restrict(np.flatnonzero((centre[0] < cell_mm) | (centre[2] < cell_mm)))
    elements = discretise(step, ELEMENTS["hex20"])
    if taken:
        contact = Contact(elements, 0.05, 0.05, "on")
        assert not contact.near(np.zeros_like(elements.positions))
    else:
        with pytest.raises(InputError, match="fem.contact_mm is 0.05 mm; it must be below half of"):
            Contact(elements, 0.05, 0.05, "on")
