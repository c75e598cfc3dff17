"""Contact of the outer skin with itself: derivatives, steps that end before a penetration, chambers that touch."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import CellBasis, MeshHex

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import DISPLACEMENT
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.collision import collision_mesh
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, discretise
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.fem import SimulationStopped
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.loading import LoadLeg
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.newton import NoConvergence
from pgdl_lab.mechanics.path import Branch, follow
from pgdl_lab.mechanics.skin import bulge, sampled, skin
from pgdl_lab.mechanics.term import DeadLoad, Ramp
from pgdl_lab.studies.stability.overlap import overlaps
from pgdl_lab.studies.verification.bodies import body
from tests.fingers import OBSERVATION, pneunet, solid, tetrahedra

GAP_MM = 1.0


@pytest.fixture(scope="module", params=["hex20", "hex27_p1", "tet10_p0"])
def mesh(request: pytest.FixtureRequest) -> Discretisation:
    mesh = pneunet(gap_mm=GAP_MM).mesh(3.0)
    return discretise(mesh if request.param.startswith("hex") else tetrahedra(mesh), ELEMENTS[request.param])


def closed_to(mesh: Discretisation, gap_mm: float, slip_mm: float = 0.0) -> NDArray[np.float64]:
    """The second chamber moved towards the first, and up; its lowest row of elements is sheared, and stays straight."""
    share = np.where(mesh.positions[:, 0] > 11, np.clip((mesh.positions[:, 2] - 8) / 3, 0, 1), 0)
    return share[:, None] * [gap_mm - GAP_MM, 0.0, slip_mm]


def test_skin_is_all_but_the_plane_of_symmetry_sorted_by_air(mesh: Discretisation) -> None:
    side = 2 * 10.5 * 17 + 8  # [mm²]
    around = 22 + 17 + 2 * 10.5 + 2 * 9 + 1 + 17  # base, tip, roofs, walls and bottom of the gap, clamp [mm]
    section = 2 * 4.5 * 9 + 16 * 2  # of both chambers and the channel [mm²]
    walls = 16 + 2 * 4.5 + 7 + 2 * 11 + 2 * 9  # around it [mm]
    outside = side + 8 * around, 8 * (22 * 17 - 1 * 9)
    inside = section + 5 * walls, -5 * section  # normals point into the chamber
    for faces, (area, volume) in zip(skin(mesh), (outside, inside), strict=True):
        for divisions in (1, 3):
            surface = sampled(faces, mesh.positions, divisions)
            corners = surface.positions[surface.triangles]
            areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
            assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(area)
            assert (areas * corners.mean(axis=1)).sum() / 3 == pytest.approx(volume)
            # Watertight but for the plane of symmetry: there its rim lies.
            edges = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
            edges, times = np.unique(edges, axis=0, return_counts=True)
            assert np.isin(times, (1, 2)).all()
            assert (np.abs(surface.positions[edges[times == 1]][..., 1]) < 1e-9).all()


def test_naming_a_face_leaves_it_in_the_skin(mesh: Discretisation) -> None:
    named = mesh.basis.mesh.with_boundaries(
        {
            **mesh.basis.mesh.boundaries,
            "tip": lambda x: np.isclose(x[0], 22),
            "facing": lambda x: np.isclose(x[0], 10.5),
        }
    )
    same = replace(mesh, basis=CellBasis(named, mesh.basis.elem))
    for faces, others in zip(skin(mesh), skin(same), strict=True):
        np.testing.assert_array_equal(faces, others)


def test_samples_of_strangers_stay_apart() -> None:
    """Two triangles far apart, whose nodes are so many numbers away that chance could take them for the same."""
    count = 3_000_000
    random = np.random.default_rng(0).random(count)
    order = np.argsort(random)
    close = int(np.diff(random[order]).argmin())
    one, other = order[close : close + 2]
    faces = np.array([[one, 1, 2, 3, 4, 5], [other, 11, 12, 13, 14, 15]])
    assert random[order[close + 1]] - random[order[close]] < 1e-12
    assert len(sampled(faces, np.zeros((count, 3)), 1).positions) == 6


def test_samples_follow_quadratic_faces_and_share_out_forces(mesh: Discretisation) -> None:
    surface = collision_mesh(sampled(skin(mesh)[0], mesh.positions, 3))
    at, x = surface.rest_positions, mesh.positions

    def bend(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return 0.01 * np.stack([x[:, 2] ** 2, x[:, 0] * x[:, 1], x[:, 0] ** 2 - x[:, 1] * x[:, 2]], axis=1)

    np.testing.assert_allclose(surface.displace_vertices(np.asfortranarray(bend(x))), at + bend(at), atol=1e-9)
    pressed = np.random.default_rng(0).normal(size=at.shape)
    forces = surface.to_full_dof(pressed.ravel()).reshape(x.shape)
    np.testing.assert_allclose(forces.sum(axis=0), pressed.sum(axis=0))
    np.testing.assert_allclose((forces * bend(x)).sum(), (pressed * bend(at)).sum())


def test_bulge_bounds_how_far_faces_are_from_flat(mesh: Discretisation) -> None:
    faces, random = np.concatenate(skin(mesh)), np.random.default_rng(0)
    assert bulge(faces, mesh.positions).max() < 1e-12
    moved = mesh.positions + 0.05 * random.normal(size=mesh.positions.shape)
    fine, flat = (collision_mesh(sampled(faces, mesh.positions, divisions)) for divisions in (6, 1))
    fine_at, flat_at = (
        surface.displace_vertices(np.asfortranarray(moved - mesh.positions)) for surface in (fine, flat)
    )
    bound, farthest = bulge(faces, moved), 0.0
    for face in range(0, len(faces), 5):  # the farthest sample from the flat triangles of its own face
        per = [len(surface.faces) // len(faces) for surface in (fine, flat)]
        samples = np.unique(fine.faces[face * per[0] : (face + 1) * per[0]])
        corners = flat_at[flat.faces[face * per[1] : (face + 1) * per[1]]]
        far = max(min(point_triangle(fine_at[v], *c) for c in corners) for v in samples)
        assert far <= bound[face]
        farthest = max(farthest, far)
    assert farthest > 0.02


def point_triangle(point: NDArray[np.float64], *corners: NDArray[np.float64]) -> float:
    import ipctk

    return float(ipctk.point_triangle_distance(point, *corners)) ** 0.5


def test_derivatives_against_differences(mesh: Discretisation) -> None:
    contact, random, step = Contact(mesh, 0.1, 0.05, "on"), np.random.default_rng(0), 1e-7
    at = closed_to(mesh, 0.06, slip_mm=0.21) + 1e-3 * random.normal(size=mesh.positions.shape)
    direction = random.normal(size=at.shape)
    here = contact.response(at, stiffness=True)
    above, below = (contact.response(at + s * direction, stiffness=False) for s in (step, -step))
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
        contact.response(closed_to(mesh, gap), stiffness=False).forces[first, 0].sum() for gap in (0.11, 0.08, 0.02)
    ]
    assert pushes[0] == 0 < pushes[1] < pushes[2]  # the gradient: the force on the first chamber points away


def test_gaps_and_penetration_are_seen(mesh: Discretisation) -> None:
    contact = Contact(mesh, 0.1, 0.05, "auto")
    assert not contact.near(closed_to(mesh, 0.12))
    assert contact.gap_mm(closed_to(mesh, 0.12)) == pytest.approx(0.12)
    assert contact.near(closed_to(mesh, 0.09)) and not contact.penetrates(closed_to(mesh, 0.09))
    assert contact.penetrates(closed_to(mesh, -0.5, slip_mm=0.1))


def test_free_step_ends_before_surfaces_meet(mesh: Discretisation) -> None:
    contact = Contact(mesh, 0.1, 0.05, "on")
    rest = np.zeros_like(mesh.positions)
    step = contact.free_step(rest, closed_to(mesh, -1.0))  # surfaces meet half-way
    assert 0.3 < step < 0.5
    assert contact.free_step(rest, closed_to(mesh, 0.3)) == 1


def test_reach_beyond_the_mesh_is_refused(mesh: Discretisation) -> None:
    with pytest.raises(InputError, match="fem.contact_mm is 0.6 mm; it must be below half .*: lower it, or choose"):
        Contact(mesh, 0.6, 0.05, "on")
    crossed = Contact(mesh, 0.6, 0.05, "off")  # never acts, so its reach does not matter
    assert crossed.penetrates(closed_to(mesh, -0.5, slip_mm=0.1)) and not crossed.penetrates(closed_to(mesh, 0.5))


def test_no_reach_is_asked_for_without_contact() -> None:
    finger = pneunet(gap_mm=0.05)
    with pytest.raises(InputError, match=r"fem.contact_mm is 0.05 mm; it must be below half of 0.0\d+ mm"):
        solid().simulate(finger, OBSERVATION)
    report = solid(contact="off").simulate(replace(finger, max_kpa=1.0), OBSERVATION).provenance["contact"]
    assert not report["acted"]


def thin(contact: str, max_kpa: float) -> Dataset:
    """Two chambers with thin walls, 0.3 mm apart; they touch at some 8 kPa."""
    finger = pneunet(wall_mm=1.5, side_wall_mm=1.5, gap_mm=0.3, max_kpa=max_kpa)
    return solid(edge_mm=3.0, contact=contact).simulate(finger, replace(OBSERVATION, points=1500))


def test_contact_comes_in_when_chambers_touch_and_prevents_penetration() -> None:
    free, touching = thin("off", 14.0).provenance["contact"], thin("auto", 14.0).provenance["contact"]
    assert free["penetration_kpa"] and not free["acted"]
    assert touching["acted"] and touching["penetration_kpa"] == []
    assert 0 < touching["smallest_gap_mm"] < 0.05


def test_no_contact_where_nothing_touches() -> None:
    watched, ready, blind = (thin(mode, 4.0) for mode in ("auto", "on", "off"))
    assert not watched.provenance["contact"]["acted"] and not ready.provenance["contact"]["acted"]
    np.testing.assert_allclose(ready.displacements, blind.displacements, atol=1e-9)
    np.testing.assert_allclose(watched.displacements, blind.displacements, atol=1e-9)


class Plates:
    """A plate held on its left; below its right end, a millimetre apart, that of a thin block that does not move."""

    def __init__(self) -> None:
        plate = MeshHex.init_tensor(np.linspace(0, 10, 6), np.array([0.0, 2.0]), np.array([0.0, 0.5]))
        block = MeshHex.init_tensor(np.array([9.0, 11.0, 13.0]), np.array([0.0, 2.0]), np.array([-1.5, -1.0]))
        mesh = (plate + block).with_boundaries({"clamp": lambda x: np.isclose(x[0], 0)})
        equilibrium = body(mesh, "hex27_p1", Yeoh(), {"clamp": "xyz"}, lambda e: Contact(e, 0.05, 0.05, "auto"))
        self.height = equilibrium.solid.discretisation.positions[:, 2]
        below = self.height < -0.9
        self.tip = np.isclose(equilibrium.solid.discretisation.positions[:, 0], 10) & ~below
        free = equilibrium.free & ~below[:, None]
        weight = DeadLoad.weight(equilibrium.solid.discretisation, np.array([0.0, 0.0, -1.0]))
        self.equilibrium = Equilibrium({**equilibrium.terms, "weight": weight}, free)
        self.contact: Any = equilibrium.contact

    def leg(self, weight: float) -> LoadLeg:
        """From no weight to `weight` [N/mm³] as the parameter goes to 1."""
        return LoadLeg(self.equilibrium, symmetric_solver(), 1e-6, Ramp({"weight": weight}))


def test_bodies_do_not_pass_each_other_within_a_step() -> None:
    plates = Plates()
    leg, rest = plates.leg(3e-5), np.zeros(plates.equilibrium.free.shape)
    leg.solve(rest, 0.0)
    plates.contact.mode = "off"
    beyond = leg.solve(rest, 1.0).displacement
    # The end of the plate is below the block, which it crosses nowhere and is not near.
    assert (plates.height + beyond[:, 2])[plates.tip].max() < -1.9
    assert not plates.contact.penetrates(beyond) and not plates.contact.near(beyond)
    plates, branch = Plates(), Branch()
    leg = plates.leg(3e-5)
    branch.add(leg, rest, 0.0)
    with pytest.raises(NoConvergence):
        branch.add(leg, rest, 1.0)
    assert plates.contact.active
    with pytest.raises(NoConvergence):  # and so from a start beyond the block
        branch.add(leg, beyond, 1.0)
    held = follow(leg, rest, 1.0, 0.04, lambda _: None).displacements[-1]
    assert (plates.height + held[:, 2])[plates.tip].min() > -1.0


def test_limit_point_with_contact_keeps_what_converged() -> None:
    finger = pneunet(wall_mm=1.5, side_wall_mm=1.5, gap_mm=0.3, max_kpa=60.0)
    with pytest.raises(SimulationStopped, match=r"equilibrium up to 4\d.* kPa, but not at finger.max_kpa=60") as caught:
        solid(interpolation_mm=0.1).simulate(replace(finger, material=Yeoh(c2_mpa=0.0)), OBSERVATION)
    kept = caught.value.snapshots
    # A gap of 0.3 mm leaves room for two triangles on an edge: elements do overlap at one of its equilibria.
    report = kept.provenance["contact"]
    assert report["acted"] and report["penetration_kpa"] == [pytest.approx(18.4, abs=0.1)]
    place = kept.provenance["equilibria_kpa"].index(report["penetration_kpa"][0])
    assert kept.body is not None
    assert overlaps(replace(kept.body, fields={DISPLACEMENT: kept.body.displacements[[place]]}))
    np.testing.assert_allclose(kept.pressures_kpa, 6.0 * np.arange(1, 8))
