"""Contact of the skin with itself: derivatives, steps that end before a penetration, chambers that touch."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.contact import Contact, skin
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, discretise
from pgdl_lab.snapshots import Snapshots
from tests.fingers import OBSERVATION, pneunet, solid, tetrahedra

GAP_MM = 1.0


@pytest.fixture(scope="module", params=["hex20", "hex27_p1", "tet10_p0"])
def mesh(request: pytest.FixtureRequest) -> Discretisation:
    mesh = pneunet(gap_mm=GAP_MM).mesh(3.0)
    return discretise(mesh if request.param.startswith("hex") else tetrahedra(mesh), ELEMENTS[request.param])


def closed_to(mesh: Discretisation, gap_mm: float, slip_mm: float = 0.0) -> NDArray[np.float64]:
    """The second chamber moved towards the first, and up."""
    second = (mesh.positions[:, 0] > 11) & (mesh.positions[:, 2] > 8.1)
    return np.where(second[:, None], [gap_mm - GAP_MM, 0.0, slip_mm], 0.0)


def test_skin_is_all_that_is_neither_held_nor_pressed(mesh: Discretisation) -> None:
    corners = mesh.positions[skin(mesh)]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    side = 2 * 10.5 * 17 + 8
    around = 22 + 17 + 2 * 10.5 + 2 * 9 + 1  # base, tip, roofs, walls and bottom of the gap [mm]
    assert area == pytest.approx(side + 8 * around)


def test_derivatives_against_differences(mesh: Discretisation) -> None:
    contact, random, step = Contact(mesh, 0.1, 0.05, "on"), np.random.default_rng(0), 1e-6
    at = closed_to(mesh, 0.06, slip_mm=0.21) + 1e-3 * random.normal(size=mesh.positions.shape)
    direction = random.normal(size=at.shape)
    here = contact.response(at, hessian=True)
    above, below = (contact.response(at + s * direction, hessian=False) for s in (step, -step))
    assert here.energy > 0
    assert (above.energy - below.energy) / (2 * step) == pytest.approx(float((here.forces * direction).sum()), rel=1e-5)
    assert here.stiffness is not None
    change = (above.forces - below.forces).ravel() / (2 * step)
    np.testing.assert_allclose(here.stiffness @ direction.ravel(), change, atol=1e-6 * np.abs(change).max())
    np.testing.assert_allclose(here.forces.sum(axis=0), 0, atol=1e-10)


def test_barrier_ends_at_its_reach_and_pushes_apart(mesh: Discretisation) -> None:
    contact = Contact(mesh, 0.1, 0.05, "on")
    first = mesh.positions[:, 0] < 11
    pushes = [
        contact.response(closed_to(mesh, gap), hessian=False).forces[first, 0].sum() for gap in (0.11, 0.08, 0.02)
    ]
    assert pushes[0] == 0 < pushes[1] < pushes[2]  # the gradient: the force on the first chamber points away


def test_gaps_and_penetration_are_seen(mesh: Discretisation) -> None:
    contact = Contact(mesh, 0.1, 0.05, "auto")
    assert not contact.touches(closed_to(mesh, 0.2))
    assert contact.gap_mm(closed_to(mesh, 0.2)) == pytest.approx(0.2)
    assert contact.touches(closed_to(mesh, 0.09)) and not contact.penetrates(closed_to(mesh, 0.09))
    assert contact.touches(closed_to(mesh, -0.5)) and contact.penetrates(closed_to(mesh, -0.5, slip_mm=0.1))


def test_free_step_ends_before_surfaces_meet(mesh: Discretisation) -> None:
    contact = Contact(mesh, 0.1, 0.05, "on")
    rest = np.zeros_like(mesh.positions)
    step = contact.free_step(rest, closed_to(mesh, -1.0))  # surfaces meet half-way
    assert 0.3 < step < 0.5
    assert contact.free_step(rest, closed_to(mesh, 0.3)) == 1


def test_reach_beyond_the_mesh_is_refused(mesh: Discretisation) -> None:
    with pytest.raises(InputError, match="fem.contact_mm is 0.6 mm; it must be below half"):
        Contact(mesh, 0.6, 0.05, "on")


def thin(contact: str, max_kpa: float) -> Snapshots:
    """Two chambers with thin walls, 0.3 mm apart; they touch at some 8 kPa."""
    finger = pneunet(wall_mm=1.5, side_wall_mm=1.5, gap_mm=0.3, max_kpa=max_kpa)
    return solid(edge_mm=3.0, contact=contact).simulate(finger, replace(OBSERVATION, points=1500))


def test_contact_comes_in_when_chambers_touch_and_prevents_penetration() -> None:
    free, touching = thin("off", 14.0).provenance["contact"], thin("auto", 14.0).provenance["contact"]
    assert free["penetration_kpa"] and not free["acted"]
    assert touching["acted"] and touching["penetration_kpa"] == []
    assert 0 < touching["smallest_gap_mm"] < 0.05


def test_no_contact_where_nothing_touches() -> None:
    watched, blind = thin("auto", 4.0), thin("off", 4.0)
    assert not watched.provenance["contact"]["acted"]
    np.testing.assert_allclose(watched.displacements, blind.displacements, atol=1e-9)
