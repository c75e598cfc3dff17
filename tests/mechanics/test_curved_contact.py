"""Curved faces that pass through each other between the triangles that contact follows them with."""

import numpy as np
import pytest
from numpy.typing import NDArray

from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.places import interpolation_at
from tests.mechanics.test_inner_contact import Bricks, discretised, low_chamber

Array = NDArray[np.float64]
REACH_MM = 0.05

# A millimetre of air beside a face of 6 mm × 6 mm: between neighbours, in a chamber, and with the mirror image.
BETWEEN = ((0, 1, 7), (0, 6), (0, 1, 2, 3))
AIR = ((1, 7), (-1, 6), (1, 2))
SCENES = {
    "between": Bricks(lines=BETWEEN, slots=(AIR,)),
    "chamber": Bricks(lines=((0, 1, 7, 8), (0, 6, 7), (0, 1, 2, 3)), chambers=(AIR,)),
    "mirror": Bricks(lines=((0, 1, 7), (0, 0.5, 1.5), (0, 6)), slots=(((1, 7), (-1, 0.5), (-1, 7)),)),
}


def bulging(mesh: Discretisation, scene: str, deep_mm: float) -> Array:
    """Both sides of the air bulge into it along x, until they overlap by `deep_mm` at their middle."""
    x, y, z = mesh.positions.T
    bump = (0.5 + deep_mm / 2) * np.where((x > 1) & (x < 7), 1 - ((x - 4) / 3) ** 2, 0.0)
    if scene == "chamber":
        bump *= np.clip(1 - (y / 6) ** 2, 0, 1)
    if scene == "mirror":
        return -(bump * np.isclose(y, 0.5))[:, None] * [0.0, 1.0, 0.0]
    return (bump * np.where(np.isclose(z, 1), 1, np.where(np.isclose(z, 2), -1, 0)))[:, None] * [0.0, 0.0, 1.0]


@pytest.mark.parametrize("element", ["hex20", "hex27_p1", "tet10_p0"])
@pytest.mark.parametrize("scene", SCENES)
def test_faces_that_slip_through_are_seen(scene: str, element: str) -> None:
    mesh = discretised(SCENES[scene], element)
    contact = Contact(mesh, REACH_MM, 0.05, "on")
    deep, shallow, apart = (bulging(mesh, scene, by) for by in (0.1, 0.5 * REACH_MM, -0.2))
    assert contact.gap_mm(deep) > 0  # the triangles have not met
    assert contact.penetrates(deep) and contact.slips_through(deep)
    assert not contact.penetrates(shallow) and not contact.slips_through(apart)


@pytest.mark.parametrize("element", ["hex20", "hex27_p1", "tet10_p0"])
def test_faces_that_cross_away_from_their_nodes_are_seen(element: str) -> None:
    """Deepest at a quarter of the edge: neither the nodes nor the flat triangles between them have met."""
    mesh = discretised(SCENES["between"], element)
    x, _, z = mesh.positions.T
    along = (x - 4) / 3
    lengths = {deep: np.where((x > 1) & (x < 7.5), 1 + deep - 0.5 * (along - 0.5) ** 2, 0.0) for deep in (0.1, 0.0)}
    sides = np.where(np.isclose(z, 1), 0.5, np.where(np.isclose(z, 2), -0.5, 0.0))
    crossed, apart = ((length * sides)[:, None] * [0.0, 0.0, 1.0] for length in lengths.values())
    contact = Contact(mesh, REACH_MM, 0.05, "on")
    assert contact.slips_through(crossed) and not contact.slips_through(apart)
    nodes = np.isclose(z, 1), np.isclose(z, 2)
    lower, upper = ((mesh.positions + crossed)[at, 2] for at in nodes)
    assert lower.max() < upper.min()


def test_states_that_others_found_are_looked_at() -> None:
    """As CalculiX finds them: a model without contact tells where they cross."""
    model = Model(SCENES["chamber"], 0.0, "hex20")
    at = model.discretisation
    states = [bulging(at, "chamber", by) for by in (-0.9, -0.2, 0.1, 0.3)]
    assert model.crossed_kpa([0.0, 1.0, 2.0, 3.0], states) == [2.0, 3.0]


def test_more_triangles_keep_them_apart() -> None:
    mesh = discretised(SCENES["between"])
    contact = Contact(mesh, REACH_MM, 0.05, "auto")
    deep, near = bulging(mesh, "between", 0.1), bulging(mesh, "between", -0.03)
    assert contact.response(deep, stiffness=False).energy > 0 and contact.gap_mm(near) == np.inf
    contact.active = True
    assert contact.follow_more_finely() and not contact.active
    assert contact.gap_mm(near) < REACH_MM and contact.near(deep)
    assert any(pairs.penetrates(deep) for pairs in contact._pairs)
    assert contact.follow_more_finely() and not contact.follow_more_finely()
    assert contact._divisions == 9  # with 10 on the end of the slot, a millimetre wide, they are within twice the reach


def test_a_simulation_starts_again_with_more_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model(low_chamber(gravity_m_s2=[0.0, -40.0]), 0.0, "hex20", "auto")
    contact = model.contact
    coarse = model.load(np.array([1e-3]), 1e-6, 0.1)
    monkeypatch.setattr(contact, "slips_through", lambda _: contact._divisions < 6)
    finer = model.load(np.array([1e-3]), 1e-6, 0.1)
    assert contact._divisions == 6 and contact.active
    off = np.abs(finer.at(1e-3) - coarse.at(1e-3)).max()
    assert 1e-6 < off < REACH_MM
    assert len(finer.branch.parameters) == len(set(finer.branch.parameters))  # nothing of the coarse one is left


def test_the_error_is_estimated_where_surfaces_touch() -> None:
    """By contact at the places where it acted, as the same triangles on the finer mesh."""
    model = Model(low_chamber(gravity_m_s2=[0.0, -40.0]), 0.0, "hex20", "auto")
    history = model.load(np.array([1e-3]), 1e-6, 0.1)
    contact = model.contact
    assert contact.near(history.at(1e-3))
    error = model.discretisation_error(history)
    assert error is not None and 0.0 < error.tip_percent < 20.0


@pytest.mark.parametrize("element", ["hex20", "hex27_p1", "tet10_p0"])
def test_places_on_the_surface_are_found_in_spite_of_round_off(element: str) -> None:
    mesh, random = discretised(SCENES["chamber"], element), np.random.default_rng(0)
    corners = mesh.positions[mesh.nodes[:, :4]]  # any four nodes of an element: their mean lies in it
    places = np.concatenate([mesh.positions + 1e-11 * random.normal(size=mesh.positions.shape), corners.mean(axis=1)])

    def field(x: Array) -> Array:
        return np.stack([x[:, 0] * x[:, 1], x[:, 2] ** 2, x[:, 0] - 3], axis=1)

    np.testing.assert_allclose(interpolation_at(mesh, places) @ field(mesh.positions), field(places), atol=1e-8)
    assert ELEMENTS[element].cells in ("hexahedra", "tetrahedra")
