"""Contact inside a chamber, with the mirror image of half a body, and none through a thin wall."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import MeshHex

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, discretise
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import History, Model
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.skin import skin
from tests.fingers import tetrahedra

Array = NDArray[np.float64]
Box = tuple[tuple[float, float], ...]
SOFT = Yeoh(c1_mpa=0.004, c2_mpa=0.0)


@dataclass(frozen=True)
class Bricks(Finger):
    """A grid of bricks, y ≥ 0 or the whole, without those in a slot and those in the chambers.

    Attributes
    ----------
    lines
        Grid lines along x, y and z [mm].
    chambers, slots
        Ranges of x, |y| and z that are taken out [mm].
    whole
        Whether the mirror image is meshed too.
    """

    lines: tuple[tuple[float, ...], ...] = ()
    chambers: tuple[Box, ...] = ()
    slots: tuple[Box, ...] = ()
    whole: bool = False

    def mesh(self, edge_mm: float) -> MeshHex:
        x, y, z = (np.array(lines) for lines in self.lines)
        block = MeshHex.init_tensor(x, np.concatenate([-y[:0:-1], y]) if self.whole else y, z)
        centres = block.p[:, block.t].mean(axis=1)
        mesh = block.restrict(np.flatnonzero(~inside(centres, self.chambers) & ~inside(centres, self.slots)))
        facets = mesh.boundary_facets()
        at = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
        beyond = at + 1e-3 * (at - mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1))
        named = {"clamp": facets[np.isclose(at[0], 0)], "cavity": facets[inside(beyond, self.chambers)]}
        if not self.whole:
            named["symmetry"] = facets[np.isclose(at[1], 0)]
            named["cavity"] = np.setdiff1d(named["cavity"], named["symmetry"])
        return mesh.with_boundaries(named)

    def face(self, points: int) -> Face:
        raise NotImplementedError


def inside(at: Array, boxes: tuple[Box, ...]) -> NDArray[np.bool_]:
    """Which points (3, N) are in one of `boxes`."""
    x, y, z = at[0], np.abs(at[1]), at[2]
    found = [[(low < each) & (each < high) for each, (low, high) in zip((x, y, z), box, strict=True)] for box in boxes]
    return np.any([np.all(each, axis=0) for each in found] or [np.zeros(x.shape, dtype=bool)], axis=0)


def low_chamber(**fields: Any) -> Bricks:
    """A wide chamber, 0.8 mm high, below a ceiling of soft rubber that sags on its floor."""
    lines = ((0, 3, 10, 17, 20), (0, 6, 9), (0, 6, 6.8, 7.8))
    chamber = ((3, 17), (-1, 6), (6, 6.8))
    return Bricks(max_kpa=1e-3, material=SOFT, lines=lines, chambers=(chamber,), **fields)


def slotted(**fields: Any) -> Bricks:
    """Two prongs beside a slot of 0.9 mm; a chamber in each presses its inner wall across the plane between both."""
    lines = ((0, 4, 8, 16, 18), (0, 0.45, 1.5, 4.5, 7.5), (0, 2, 8, 10))
    return Bricks(
        lines=lines, chambers=(((8, 16), (1.5, 4.5), (2, 8)),), slots=(((4, 18), (-1, 0.45), (0, 10)),), **fields
    )


def inflated(finger: Finger, contact: str = "auto") -> tuple[Model, History]:
    model = Model(finger, 0.0, "hex20", contact)
    return model, model.load(np.array([finger.max_kpa]), 1e-6, 0.1)


def discretised(finger: Finger, element: str = "hex20") -> Discretisation:
    mesh = finger.mesh(0.0)
    return discretise(tetrahedra(mesh) if element.startswith("tet") else mesh, ELEMENTS[element])


def squeezed(mesh: Discretisation, half_gap_mm: float, chamber_mm: float, slip_mm: float = 0.0) -> Array:
    """The prong bent towards the plane of symmetry, and its chamber made narrow and sheared along z."""
    x, y, _ = mesh.positions.T
    inwards = np.clip((x - 4) / 4, 0, 1) * np.where(y > 0, 0.45 - half_gap_mm, 0.0)
    closing = np.clip((x - 8) / 4, 0, 1) * np.clip((y - 1.5) / 3, 0, 1)
    inwards += closing * (3 - chamber_mm)
    return np.stack([np.zeros_like(x), -inwards, slip_mm * closing], axis=1)


def pinched(mesh: Discretisation, gap_mm: float) -> Array:
    """The outer wall of the chamber bent inwards, up to `gap_mm` from the inner one at the samples of its face."""
    x, y, z = mesh.positions.T
    bump = np.clip(1 - ((x - 12) / 4) ** 2, 0, 1) * np.clip(1 - ((z - 5) / 3) ** 2, 0, 1) * (y > 1.6)
    return -(81 / 64 * (3 - gap_mm) * bump)[:, None] * [0.0, 1.0, 0.0]


@pytest.mark.parametrize("element", ["hex20", "hex27_p1", "tet10_p0"])
def test_derivatives_against_differences(element: str) -> None:
    mesh, random, step = discretised(slotted(), element), np.random.default_rng(1), 1e-7
    contact = Contact(mesh, 0.07, 0.05, "on")
    direction = random.normal(size=mesh.positions.shape)
    for half_gap, chamber in ((0.02, 2.0), (0.2, 0.05), (0.02, 0.05)):  # the plane, the chamber, both
        at = squeezed(mesh, half_gap, chamber, slip_mm=0.21) + 1e-3 * random.normal(size=mesh.positions.shape)
        here = contact.response(at, stiffness=True)
        above, below = (contact.response(at + s * direction, stiffness=False) for s in (step, -step))
        assert here.energy > 0 and here.stiffness is not None
        slope = (above.energy - below.energy) / (2 * step)
        assert slope == pytest.approx(float((here.forces * direction).sum()), rel=1e-5)
        change = (above.forces - below.forces).ravel() / (2 * step)
        np.testing.assert_allclose(here.stiffness @ direction.ravel(), change, atol=1e-6 * np.abs(change).max())


def test_pressure_of_the_mirror_image_is_that_of_the_barrier() -> None:
    reach, scale, half_gap = 0.1, 0.05, 0.03
    lines = np.array([0.0, 2.0]), np.array([half_gap, 2.0]), np.array([0.0, 4.0, 8.0])
    at_plane = MeshHex.init_tensor(np.array([5.0, 6.0]), np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    mesh = (MeshHex.init_tensor(*lines) + at_plane).with_boundaries(
        {"symmetry": lambda x: np.isclose(x[1], 0), "others": lambda x: ~np.isclose(x[1], half_gap)}
    )
    elements = discretise(mesh, ELEMENTS["hex27_p1"])
    away = np.where(elements.positions[:, [0]] < 3, [0.0, 1.0, 0.0], 0.0)
    apart = replace(elements, positions=elements.positions + away)
    forces = Contact(apart, reach, scale, "on", cut=("symmetry", "others")).response(-away, stiffness=False).forces
    gap, square = 2 * half_gap, (2 * half_gap / reach) ** 2
    pressure = scale * (2 * reach / gap * (square - 1) ** 2 + 4 * gap / reach * (square - 1) * np.log(square))
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, -2 * 8 * pressure, 0.0], rtol=1e-9, atol=1e-9)


def test_motions_that_break_the_symmetry_leave_the_gap_to_the_mirror_image() -> None:
    """Both prongs moved to the same side: nothing resists in the whole body, nor in half of it without its image."""
    half = discretised(slotted())
    stiff = {}
    for whole, mirror in ((True, True), (False, False), (False, True)):
        mesh = discretised(slotted(whole=whole))
        same = cKDTree(half.positions).query(np.abs(mesh.positions))[1]
        side = np.where(mesh.positions[:, [1]] < 0, [1.0, -1.0, 1.0], 1.0)
        contact = Contact(mesh, 0.05, 0.05, "on")
        at = side * squeezed(half, 0.02, 2.0)[same]
        touching = contact.response(at, stiffness=True) if mirror else contact.sideways(at)
        aside = np.tile([0.0, 1.0, 0.0], len(mesh.positions))
        assert touching.stiffness is not None
        stiff[whole, mirror] = float(aside @ (touching.stiffness @ aside))
    assert stiff[False, True] > 1
    assert abs(stiff[True, True]) < 1e-9 and abs(stiff[False, False]) < 1e-9


def test_gaps_and_penetration_are_seen() -> None:
    mesh = discretised(slotted(), "hex27_p1")
    contact = Contact(mesh, 0.05, 0.05, "auto")
    rest, apart = np.zeros_like(mesh.positions), squeezed(mesh, 0.04, 2.0)
    near, crossed = squeezed(mesh, 0.02, 2.0), squeezed(mesh, -0.01, 2.0)
    assert contact.gap_mm(rest) == np.inf and not contact.penetrates(rest)
    assert contact.gap_mm(apart) == np.inf and not contact.near(apart)
    assert contact.gap_mm(near) == pytest.approx(0.04) and contact.near(near) and not contact.penetrates(near)
    assert contact.gap_mm(crossed) == 0 and contact.near(crossed) and contact.penetrates(crossed)
    assert contact.passes(apart, crossed) and not contact.passes(rest, apart)
    assert 0.7 < contact.free_step(rest, crossed) < 0.45 / 0.46 and contact.free_step(rest, near) == 1
    assert contact.near(pinched(mesh, 0.045)) and not contact.near(pinched(mesh, 0.055))
    assert contact.gap_mm(pinched(mesh, 0.045)) == pytest.approx(0.045)
    assert not contact.penetrates(pinched(mesh, 0.7)) and contact.penetrates(pinched(mesh, -0.1))
    assert contact.penetrates(pinched(mesh, 0.045))  # its middle is beyond, though no sample is
    assert contact.passes(pinched(mesh, 0.5), pinched(mesh, -3)) and not contact.passes(rest, pinched(mesh, 0.5))


def test_half_a_body_meets_its_mirror_image_as_both_halves_meet() -> None:
    found = {}
    for whole in (False, True):
        model, history = inflated(slotted(whole=whole, max_kpa=45.0))
        found[whole] = model.discretisation.positions, history.at(45.0)
        report = model.contact_report(history)
        assert report["acted"] and report["penetration_kpa"] == [] and 0 < report["smallest_gap_mm"] < 0.05
    distance, same = cKDTree(found[True][0]).query(found[False][0])
    assert distance.max() < 1e-9
    # Opposite each other exactly, the samples of both halves count several times over: gaps differ, within the reach.
    assert np.abs(found[True][1][same] - found[False][1]).max() < 0.0125
    model, history = inflated(slotted(max_kpa=45.0), "off")
    assert np.abs(found[False][1] - history.at(45.0)).max() > 0.15
    report = model.contact_report(history)
    assert report["penetration_kpa"][-1] == 45.0 and report["smallest_gap_mm"] == 0 and not report["acted"]


def test_a_ceiling_rests_on_the_floor_of_its_chamber() -> None:
    height = {}
    for contact in ("auto", "off"):
        model, history = inflated(low_chamber(gravity_m_s2=[0.0, -40.0]), contact)
        displacement, at = history.branch.displacements[0], model.discretisation.positions
        middle = np.isclose(at[:, 0], 10) & np.isclose(at[:, 1], 0)
        floor, ceiling = (float(displacement[middle & np.isclose(at[:, 2], z), 2][0]) + z for z in (6.0, 6.8))
        height[contact] = ceiling - floor
        report = model.contact_report(history)
        assert report["acted"] == (contact == "auto") and bool(report["penetration_kpa"]) == (contact == "off")
        if contact == "auto":
            forces = model.contact.response(displacement, stiffness=False).forces
            below = at[:, 2] < 6.4
            assert forces[below, 2].sum() > 1e-6  # the gradient: the ceiling pushes the floor down
            np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-9)
            np.testing.assert_allclose(np.cross(at + displacement, forces).sum(axis=0), 0, atol=1e-8)
    assert height["off"] < 0.2 < height["auto"]


def test_walls_of_a_chamber_meet_as_those_of_a_void_that_is_no_chamber() -> None:
    finger = low_chamber(gravity_m_s2=[0.0, -40.0])
    model, history = inflated(finger)
    mesh = model.mesh
    at_tip = mesh.boundary_facets()[mesh.p[0, mesh.facets[:, mesh.boundary_facets()]].min(axis=0) > 19.9]
    void = mesh.with_boundaries({**mesh.boundaries, "cavity": at_tip[:1]})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Bricks, "mesh", lambda *_: void)
        _, other = inflated(replace(finger, max_kpa=1e-9))
    np.testing.assert_allclose(history.branch.displacements[0], other.branch.displacements[0], atol=1e-6)


def plate(thick_mm: float, element: str) -> Discretisation:
    lines = np.linspace(0, 10, 6), np.linspace(0, 6, 4), np.array([0.0, thick_mm])
    return discretise(MeshHex.init_tensor(*lines), ELEMENTS[element])


@pytest.mark.parametrize("element", ["hex20", "hex27_p1"])
def test_both_sides_of_a_thin_wall_are_no_contact(element: str) -> None:
    mesh = plate(0.04, element)
    contact = Contact(mesh, 0.05, 0.05, "on")
    thinner = -0.5 * mesh.positions * [0.0, 0.0, 1.0]
    assert not contact.near(thinner) and contact.response(thinner, stiffness=False).energy == 0
    # Rolled up, it meets itself as any other.
    angle = mesh.positions[:, 0] * 2 * np.pi / 10.02
    radius = 10.02 / (2 * np.pi) - mesh.positions[:, 2]
    rolled = np.stack([radius * np.sin(angle), mesh.positions[:, 1], -radius * np.cos(angle)], axis=1)
    assert contact.near(rolled - mesh.positions) and not contact.penetrates(rolled - mesh.positions)


def test_chambers_with_a_thin_wall_between_them_do_not_meet_through_it() -> None:
    lines = ((0, 3, 6, 6.03, 9, 12), (0, 4, 6), (0, 3, 6, 9))
    chambers = tuple(((low, high), (-1.0, 4.0), (3.0, 6.0)) for low, high in ((3.0, 6.0), (6.03, 9.0)))
    mesh = discretised(Bricks(lines=lines, chambers=chambers))
    assert [len(faces) for faces in skin(mesh)[1:]] == [5, 5]
    contact = Contact(mesh, 0.05, 0.05, "on")
    thinner = np.where(mesh.positions[:, [0]] > 6.02, [-0.02, 0.0, 0.0], 0.0)
    assert not contact.near(thinner) and contact.response(thinner, stiffness=False).energy == 0


def test_surfaces_that_touch_at_rest_are_refused_with_what_helps() -> None:
    cube = MeshHex.init_tensor(*3 * [np.linspace(0, 1, 3)])
    above = cube.translated([0.3, 0.2, 1.0])
    beside = MeshHex(np.hstack([cube.p, above.p]), np.hstack([cube.t, above.t + cube.p.shape[1]]))
    with pytest.raises(InputError, match="touch or cross each other, .*: merge nodes .*fem.contact=off"):
        Contact(discretise(beside, ELEMENTS["hex20"]), 0.05, 0.05, "auto")
    Contact(discretise(beside, ELEMENTS["hex20"]), 0.05, 0.05, "off")
    slit = cube.with_boundaries({"symmetry": lambda x: np.isclose(x[1], 0) & (x[0] < 0.5)})
    with pytest.raises(InputError, match="lie in the plane of symmetry, .*: put them into its group, or choose"):
        Contact(discretise(slit, ELEMENTS["hex20"]), 0.05, 0.05, "on")
