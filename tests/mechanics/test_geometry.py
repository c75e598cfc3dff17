"""Profile, side face and mesh of an extruded finger."""

from typing import Any

import numpy as np
import pytest

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.profile import Profile, Region, subdivide
from tests.fingers import pneunet


def area(points: Any, triangles: Any) -> float:
    a, b = (points[triangles[:, i]] - points[triangles[:, 0]] for i in (1, 2))
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def test_subdivide_keeps_the_lines_and_the_longest_edge() -> None:
    lines = subdivide(np.array([0.0, 3.0, 7.5]), 3.0)
    np.testing.assert_allclose(lines, [0, 3, 5.25, 7.5])


def test_region_outside_the_grid_is_a_gap() -> None:
    profile = Profile(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array([[Region.SOLID]], dtype=np.int8))
    x, z = np.array([0.5, -0.5, 1.5, 0.5, 0.5]), np.array([0.5, 0.5, 0.5, -1.0, 2.0])
    np.testing.assert_array_equal(profile.region(x, z), [Region.SOLID, *[Region.GAP] * 4])


def test_mesh_of_the_reference_finger() -> None:
    """Element and node counts of the reference finger with edges up to 3 mm, from an independent mesher."""
    import skfem

    mesh = pneunet(chambers=10).mesh(3.0)
    assert mesh.nelements == 587
    assert skfem.Basis(mesh, skfem.ElementHexS2()).N == 4522
    corners = mesh.p[:, mesh.t]
    volume = np.prod(corners.max(axis=1) - corners.min(axis=1), axis=0).sum()
    section = 10 * 10.5 * 17 + 9 * 1 * 8  # chambers and bridges [mm²]
    cavities = 10 * 4.5 * 11 + 9 * 7 * 2  # chambers and channel [mm²]
    assert volume == pytest.approx(section * 8 - cavities * 5)


@pytest.mark.parametrize("edge_mm", [3.0, 8.0])  # larger than cavities and walls are thick
def test_boundaries_hold_all_their_facets(edge_mm: float) -> None:
    finger = pneunet(base_mm=7.0)
    mesh = finger.mesh(edge_mm)

    def surface(name: str) -> float:
        corners = mesh.p[:, mesh.facets[:, mesh.boundaries[name]]]
        extent = np.sort(corners.max(axis=1) - corners.min(axis=1), axis=0)
        return float((extent[1] * extent[2]).sum())

    assert surface("clamp") == pytest.approx(21 * 8)
    perimeter = 2 * (2 * (4.5 + 11) - 2) + 2 * 7  # two chambers less the mouths of the channel, and the channel [mm]
    cavity = 2 * 4.5 * 11 + 7 * 2
    assert surface("cavity") == pytest.approx(perimeter * 5 + cavity)
    assert surface("symmetry") == pytest.approx(2 * 10.5 * 21 + 12 - cavity)


@pytest.mark.parametrize("count", [800, 1001, 4439])
def test_face_has_the_points_asked_for_and_covers_the_side(count: int) -> None:
    face = pneunet().face(count)
    assert face.points.shape == (count, 2)
    assert np.unique(face.points, axis=0).shape == (count, 2)
    assert area(face.points, face.triangles) == pytest.approx(2 * 10.5 * 17 + 8, rel=1e-9)
    assert face.y_mm == 8.0


def test_base_line_runs_from_the_clamp_to_the_tip() -> None:
    face = pneunet().face(1000)
    base = face.points[face.base]
    assert (np.diff(base[:, 0]) > 0).all()
    np.testing.assert_allclose(base[[0, -1]], [[0, 0], [22, 0]])
    np.testing.assert_allclose(face.points[face.clamp, 0], 0)


def test_too_few_points_for_the_outline() -> None:
    with pytest.raises(InputError, match="observation.points is 10, but the outline"):
        pneunet().face(10)
