import numpy as np
import pytest

from pgdl_lab.core.simplices import SimplexMesh
from tests.synthetic import comb


def test_located_points_are_their_triangles_weighted_corners() -> None:
    body = SimplexMesh(*comb(2.0))
    weights = np.random.default_rng(0).dirichlet(np.ones(3), len(body.simplices))
    points = np.einsum("tc,tci->ti", weights, body.points_mm[body.simplices])
    corners, found = body.locate(points)
    assert np.einsum("tc,tci->ti", found, body.points_mm[corners]) == pytest.approx(points)
    assert body.distance_mm(points, corners, found).max() < 1e-12


def test_nodes_are_located_at_themselves() -> None:
    body = SimplexMesh(*comb(2.0))
    corners, weights = body.locate(body.points_mm)
    assert np.array_equal(corners[np.arange(len(corners)), weights.argmax(axis=1)], np.arange(len(body.points_mm)))


def test_a_point_off_the_body_is_taken_to_its_outline() -> None:
    body = SimplexMesh(*comb(2.0))
    points = np.array([[10.9, 15.0], [-3.0, 4.0], [5.0, 20.0], [200.0, -10.0], [5.0, 5.0]])
    expected = np.array([[10.5, 15.0], [0.0, 4.0], [5.0, 17.0], [114.0, 0.0], [5.0, 5.0]])
    corners, weights = body.locate(points)
    found = np.einsum("nc,nci->ni", weights, body.points_mm[corners])
    assert found == pytest.approx(expected, abs=1e-9)
    assert body.distance_mm(points, corners, weights) == pytest.approx(np.linalg.norm(expected - points, axis=1))


def test_no_points_are_located_nowhere() -> None:
    corners, weights = SimplexMesh(*comb(2.0)).locate(np.empty((0, 2)))
    assert corners.shape == weights.shape == (0, 3)
