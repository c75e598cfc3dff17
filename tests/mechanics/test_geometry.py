"""Profile, side face and mesh of an extruded finger."""

from typing import Any

import numpy as np
import pytest

from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.discretisation_error import refined
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.lattice import halved
from pgdl_lab.mechanics.newton import solve
from pgdl_lab.mechanics.profile import Profile, Region, subdivide
from tests.fingers import REFERENCE, pneunet

STOCK = {name: registry.plugin("finger", name)() for name in ("bellows", "joints", "pneunet")}
STOCK["pneunet_reference"] = registry.plugin("finger", "pneunet")(**REFERENCE)


def area(points: Any, triangles: Any) -> float:
    a, b = (points[triangles[:, i]] - points[triangles[:, 0]] for i in (1, 2))
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def grid_lines(mesh: Any) -> list[Any]:
    """Where the planes between the elements lie along x, y and z [mm]."""
    return [np.unique(np.round(component, 9)) for component in mesh.p]


def test_subdivide_keeps_the_lines_and_the_longest_edge() -> None:
    lines = subdivide(np.array([0.0, 3.0, 7.5]), 3.0)
    np.testing.assert_allclose(lines, [0, 3, 5.25, 7.5])
    np.testing.assert_allclose(subdivide(np.array([0.0, 1.0, 3.2, 6.5]), 3.0), [0, 1, 3.2, 4.85, 6.5])
    np.testing.assert_allclose(subdivide(np.array([0.0, 1.0, 4.0]), 1.5, halvings=1), [0, 0.5, 1, 2.5, 4])


@pytest.mark.parametrize("ratio", [0.5, 2 / 3, 1, 4 / 3, 1.5, 2, 2.5, 3, 4, 5])
def test_neighbours_of_round_dimensions_have_their_mesh(ratio: float) -> None:
    """Over 6 % on either side nothing jumps: the edges there are those of the round dimension, stretched."""
    around = [subdivide(np.array([0.0, share * 3 * ratio]), 3.0) / share for share in (0.94, 1.0, 1.06)]
    for lines in around:
        np.testing.assert_allclose(lines, around[1])


def test_tip_does_not_jump_where_walls_are_as_thick_as_the_edge() -> None:
    """A micrometre more or less changes what it changes, and the mesh stays: the tip moves along a straight line."""
    tips, elements = [], set()
    for wall in (2.9, 2.999, 3.001, 3.1):
        model = Model(pneunet(chambers=2, wall_mm=wall, side_wall_mm=wall), 3.0, "hex27_p1")
        rest = np.zeros(model.equilibrium.free.shape)
        found = solve(model.equilibrium, model.solver, rest, model.amplitudes(2.0), 1e-6).displacement
        tips.append(found[:, 2].min())
        elements.add(model.mesh.nelements)
    assert len(elements) == 1
    slope = (tips[3] - tips[0]) / 0.2
    assert tips[2] - tips[1] == pytest.approx(0.002 * slope, rel=0.05)


@pytest.mark.parametrize("name", STOCK)
def test_half_the_edge_is_the_mesh_with_each_element_halved(name: str) -> None:
    finger = STOCK[name]
    coarse, fine = finger.mesh(3.0), finger.mesh(1.5)
    assert fine.nelements == 8 * coarse.nelements
    for before, after in zip(grid_lines(coarse), grid_lines(fine), strict=True):
        np.testing.assert_allclose(after, halved(before), atol=1e-8)
    profile = finger.profile()
    for edge in (1.5, 0.75):
        before, after = profile.refined(edge), profile.refined(edge / 2)
        np.testing.assert_allclose(after.x, halved(before.x), rtol=1e-12)
        np.testing.assert_allclose(after.z, halved(before.z), rtol=1e-12)


@pytest.mark.parametrize("gravity", [[0.0, -9.81], [0.0, 9.81, 0.0]])
def test_half_the_edge_is_what_the_discretisation_estimate_refines_to(gravity: list[float]) -> None:
    finger = pneunet(gravity_m_s2=gravity)
    by_halves, fine = refined(finger.mesh(3.0)), finger.mesh(1.5)

    def facets(mesh: Any, name: str) -> Any:
        middles = mesh.p[:, mesh.facets[:, mesh.boundaries[name]]].mean(axis=1)
        return np.round(middles[:, np.lexsort(np.round(middles, 6))], 6)

    assert by_halves.boundaries.keys() == fine.boundaries.keys()
    for name in fine.boundaries:
        np.testing.assert_allclose(facets(by_halves, name), facets(fine, name), atol=1e-6)


@pytest.mark.parametrize("name", STOCK)
def test_stock_fingers_are_clear_of_a_jump(name: str) -> None:
    """By 15 % in the mean interval, at which all elements are halved, and by 2 % in all dimensions at once."""
    profile = STOCK[name].profile()
    for share in (1 / 1.15, 1.15):
        scaled = Profile(share * profile.x, share * profile.z, profile.regions)
        assert [scaled.halvings(edge) for edge in (3.0, 1.5)] == [0, 1]
    for lines in (profile.x, profile.z, np.cumsum([0.0, STOCK[name].width_mm / 2 - STOCK[name].side_wall_mm])):
        counts = {len(subdivide(share * lines, 3.0)) for share in (1 / 1.02, 1.0, 1.02)}
        assert len(counts) == 1


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
    assert face.domain.points_mm.shape == (count, 2)
    assert np.unique(face.domain.points_mm, axis=0).shape == (count, 2)
    assert area(face.domain.points_mm, face.domain.cells) == pytest.approx(2 * 10.5 * 17 + 8, rel=1e-9)
    assert face.y_mm == 8.0


def test_base_line_runs_from_the_clamp_to_the_tip() -> None:
    face = pneunet().face(1000)
    base = face.domain.points_mm[face.domain.base]
    assert (np.diff(base[:, 0]) > 0).all()
    np.testing.assert_allclose(base[[0, -1]], [[0, 0], [22, 0]])
    np.testing.assert_allclose(face.domain.points_mm[face.domain.clamp, 0], 0)


def test_too_few_points_for_the_outline() -> None:
    with pytest.raises(InputError, match="observation.points is 10, but the outline"):
        pneunet().face(10)
