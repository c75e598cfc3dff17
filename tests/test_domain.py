"""Where points lie in a body of any dimension, and what a field is there."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from pgdl_lab.core.domain import PARTS, Domain
from pgdl_lab.core.simplices import SimplexMesh
from pgdl_lab.mechanics.vtk import HEXAHEDRON, TETRAHEDRON

CELLS = {
    "tetra": TETRAHEDRON[:4],
    "tetra10": TETRAHEDRON[:10],
    "hexahedron": HEXAHEDRON[:8],
    "hexahedron20": HEXAHEDRON[:20],
    "hexahedron27": HEXAHEDRON,
}
SHEAR = np.array([[3.0, 0.5, 0.0], [0.2, 2.0, 0.4], [0.0, -0.3, 1.5]])


def volume(mesh: SimplexMesh) -> float:
    corners = mesh.points_mm[mesh.simplices]
    return float(np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6)


@pytest.mark.parametrize("cell_type", CELLS)
def test_an_element_is_filled_once_by_its_simplices(cell_type: str) -> None:
    points = CELLS[cell_type] @ SHEAR.T
    mesh = Domain(points, np.arange(len(points))[None], cell_type).mesh
    whole = abs(np.linalg.det(SHEAR)) / (6 if cell_type.startswith("tetra") else 1)
    corners = mesh.points_mm[mesh.simplices]
    parts = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert (parts > 0).all() and parts.sum() == pytest.approx(whole)
    inside = np.random.default_rng(0).dirichlet(np.ones(len(points)), 50) @ points
    slopes = mesh.affine[1]
    weights = np.einsum("sij,psj->psi", slopes, inside[:, None] - mesh.affine[0])
    covered = (weights > 1e-12).all(axis=2) & (weights.sum(axis=2) < 1 - 1e-12)
    assert (covered.sum(axis=1) == 1).all()


@pytest.mark.parametrize("cell_type", CELLS)
def test_linear_fields_are_interpolated_exactly(cell_type: str) -> None:
    points = CELLS[cell_type] @ SHEAR.T
    domain = Domain(points, np.arange(len(points))[None], cell_type)
    asked = np.random.default_rng(1).dirichlet(np.ones(len(points)), 20) @ points
    slopes = np.array([[1.0, -2.0, 0.5], [0.0, 3.0, 1.0]])
    nodal = np.stack([points @ slopes.T + shift for shift in (0.0, 7.0)])  # two cases
    expected = np.stack([asked @ slopes.T + shift for shift in (0.0, 7.0)])
    np.testing.assert_allclose(domain.interpolate(nodal, asked), expected, atol=1e-12)


def cube(count: int) -> Domain:
    """The unit cube in count³ hexahedra of eight nodes."""
    number = np.arange((count + 1) ** 3).reshape(3 * [count + 1])
    at = np.stack(np.meshgrid(*3 * [np.linspace(0, 1, count + 1)], indexing="ij"), -1).reshape(-1, 3)
    i, j, k = (place.ravel() for place in np.meshgrid(*3 * [np.arange(count)], indexing="ij"))
    corners = HEXAHEDRON[:8].round().astype(int)
    return Domain(at, np.stack([number[i + a, j + b, k + c] for a, b, c in corners], axis=1), "hexahedron")


def test_points_off_a_body_in_space_are_taken_to_its_nearest_face_edge_or_corner() -> None:
    body = cube(3)
    off = np.array([[0.4, 0.35, 1.5], [0.5, -0.2, 1.3], [2.0, 2.0, 2.0], [-0.1, 0.5, 0.5], [0.21, 0.33, 0.97]])
    corners, weights = body.locate(off)
    found = np.einsum("mc,mci->mi", weights, body.points_mm[corners])
    np.testing.assert_allclose(found, np.clip(off, 0, 1), atol=1e-12)
    assert (weights >= 0).all() and weights.sum(axis=1) == pytest.approx(1)
    distance = body.mesh.distance_mm(off, corners, weights)
    np.testing.assert_allclose(distance, np.linalg.norm(off - np.clip(off, 0, 1), axis=1), atol=1e-12)


def nearest_by_search(points: NDArray[np.float64], mesh: SimplexMesh) -> NDArray[np.float64]:
    """Distances from the outline, by many points on each of its facets."""
    rng = np.random.default_rng(2)
    weights = np.concatenate([rng.dirichlet(0.5 * np.ones(3), 4000), np.eye(3)])
    facets = mesh.points_mm[mesh.outline[:, :3]]
    on = np.einsum("wc,fci->fwi", weights, facets).reshape(-1, 3)
    return np.array([np.linalg.norm(on - point, axis=1).min() for point in points])


def test_nearest_points_of_a_crooked_body() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(12, 3))
    hull = Delaunay(points)
    simplices = hull.simplices.astype(np.int64)
    corners = points[simplices]
    turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    simplices[turned] = simplices[turned][:, [1, 0, 2, 3]]
    mesh = SimplexMesh(points, simplices)
    off = 3 * rng.normal(size=(15, 3))
    off = off[hull.find_simplex(off) < 0]
    corners, weights = mesh.locate(off)
    distance = mesh.distance_mm(off, corners, weights)
    searched = nearest_by_search(off, mesh)
    assert (distance <= searched + 1e-12).all() and (searched - distance < 0.05).all()


@pytest.mark.parametrize(
    "change",
    [
        {"cell_type": "wedge"},
        {"cells": np.array([[0, 1, 2, 9]])},
        {"cells": np.array([[0, 1, 2]])},
        {"points_mm": np.zeros((4, 2))},
        {"points_mm": np.full((4, 3), np.nan)},
        {"base": np.array([-1])},
        {"clamp": np.array([[0]])},
        {"points_mm": np.zeros((4, 3), dtype=np.float32)},
    ],
)
def test_arrays_that_are_no_domain_are_noticed(change: dict[str, object]) -> None:
    given = {"points_mm": np.eye(4, 3), "cells": np.array([[0, 1, 2, 3]]), "cell_type": "tetra"}
    assert Domain(**given).fits()  # type: ignore[arg-type]
    assert not Domain(**given | change).fits()  # type: ignore[arg-type]


def test_parts_are_those_of_the_elements_that_are_simulated() -> None:
    assert {"tetra10", "hexahedron20", "hexahedron27", "triangle"} <= PARTS.keys()
