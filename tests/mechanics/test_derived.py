"""Outputs that the mechanics derive from a displacement, against closed forms."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from skfem import MeshHex

import pgdl_lab as lab
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.mechanics.derived import Mechanics
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.material import Yeoh
from tests.whole import body, whole_finger

SIDES = np.array([4.0, 3.0, 2.0])  # of the block [mm]
RUBBER = Yeoh(c1_mpa=0.2, c2_mpa=0.0, poisson=0.45)


@dataclass(frozen=True)
class Block(Finger):
    """A block that is held at x = 0, with air upon its top."""

    def mesh(self, edge_mm: float) -> MeshHex:
        mesh = MeshHex.init_tensor(*(np.linspace(0, side, 3) for side in SIDES))
        return mesh.with_boundaries({"clamp": lambda x: x[0] == 0, "cavity": lambda x: x[2] == SIDES[2]})

    def face(self, points: int) -> Any:
        raise NotImplementedError


@dataclass(frozen=True)
class Holes(Block):
    """A block with two holes, of 1 mm³ and of 2 mm³."""

    def mesh(self, edge_mm: float) -> MeshHex:
        x = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 6.0])
        block = MeshHex.init_tensor(x, *[np.arange(4.0)] * 2)
        middle = block.p[:, block.t].mean(axis=1)
        hollow = (np.abs(middle[1:] - 1.5) < 0.1).all(axis=0) & (
            np.isclose(middle[0], 1.5) | np.isclose(middle[0], 4.0)
        )
        mesh = block.restrict(np.flatnonzero(~hollow))
        return mesh.with_boundaries({
            "clamp": lambda x: x[0] == 0,
            "cavity": lambda x: (np.abs(x[1:] - 1.5) < 0.6).all(axis=0) & (x[0] > 0.5) & (x[0] < 5.5),
        })  # fmt: skip


@pytest.fixture(scope="module")
def block() -> Mechanics:
    return Mechanics(Model(Block(material=RUBBER, density_kg_m3=2000.0), 2.0, "hex27_p1"))


def stretched(block: Mechanics, *stretches: float) -> np.ndarray:
    return block.model.discretisation.positions * (np.array(stretches) - 1)


def test_stretches_and_stress_of_a_uniform_stretch(block: Mechanics) -> None:
    """Neo-Hooke: σ = μ J^(−5/3) dev(F Fᵀ) + K (J − 1) 1."""
    stretches = np.array([1.3, 0.9, 0.95])
    moved = stretched(block, *stretches)
    expected = np.sort(stretches)[::-1]
    np.testing.assert_allclose(block.stretches(moved), np.broadcast_to(expected, (8, 27, 3)))
    j, squares = stretches.prod(), stretches**2
    principal = 0.4 * j ** (-5 / 3) * (squares - squares.mean()) + RUBBER.bulk_modulus_mpa * (j - 1)
    stress = block.stress_mpa(moved)
    np.testing.assert_allclose(stress, np.broadcast_to(np.diag(principal), (8, 27, 3, 3)), atol=1e-10)
    a, b, c = principal
    mises = np.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 2)
    np.testing.assert_allclose(block.von_mises_mpa(moved), mises)
    np.testing.assert_allclose(block.mean(stress), np.broadcast_to(np.diag(principal), (8, 3, 3)), atol=1e-10)


def test_turning_as_a_whole_strains_nothing_and_turns_the_stress(block: Mechanics) -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    places = block.model.discretisation.positions
    np.testing.assert_allclose(block.stretches(places @ turn.T - places), 1)
    moved = stretched(block, 1.2, 1.0, 1.0)
    turned = (places + moved) @ turn.T - places
    np.testing.assert_allclose(block.stress_mpa(turned), turn @ block.stress_mpa(moved) @ turn.T, atol=1e-12)


def test_load_is_weight_and_pressure_by_area(block: Mechanics) -> None:
    moved = stretched(block, 1.5, 1.0, 1.0)  # the top then has 1.5 times its area
    _, load = block.reaction_n(moved, 10.0)
    weight = 2000e-12 * 9810 * SIDES.prod()
    np.testing.assert_allclose(load, [0, 0, -weight - 0.01 * 1.5 * SIDES[0] * SIDES[1]], atol=1e-12)


def test_reaction_of_a_pulled_block_is_stress_by_area(block: Mechanics) -> None:
    moved = stretched(block, 1.3, 0.9, 0.95)
    (pull, *_), _ = block.reaction_n(moved, 0.0)
    sigma = float(block.stress_mpa(moved)[0, 0, 0, 0])
    # nothing pushes at the other end: half of the elements along x carry the stress on to the nodes that are held
    assert pull == pytest.approx(-sigma * 0.9 * 0.95 * SIDES[1] * SIDES[2], rel=1e-9)


def test_equilibrium_of_a_finger_carries_its_weight() -> None:
    known = body()
    mechanics = Mechanics.of(known)
    corners = known.domain.points_mm[known.domain.mesh.simplices]
    volume = 2 * np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
    reaction, load = mechanics.reaction_n(known.displacements[-1], float(known.pressures_kpa[-1]))
    weight = 1130e-12 * 9810 * volume
    np.testing.assert_allclose(reaction, [0, 0, weight], atol=1e-6 * weight)
    np.testing.assert_allclose(load, [0, 0, -weight], atol=1e-6 * weight)


def test_volume_of_the_chamber_is_that_of_the_drawing() -> None:
    mechanics, finger = Mechanics.of(body()), whole_finger()
    profile, across = finger.profile(), finger.width_mm - 2 * finger.side_wall_mm
    areas = np.outer(np.diff(profile.x), np.diff(profile.z))[profile.regions == 2]
    assert mechanics.chamber_volumes_mm3().tolist() == [pytest.approx(areas.sum() * across)]
    # a body that is twice as large in all directions encloses eight times as much
    swollen = mechanics.chamber_volumes_mm3(mechanics.model.discretisation.positions)
    assert swollen == pytest.approx(8 * mechanics.chamber_volumes_mm3())
    assert mechanics.chamber_volumes_mm3(body().displacements[-1]) > mechanics.chamber_volumes_mm3()


def test_chambers_are_told_apart_from_the_root_to_the_tip() -> None:
    mechanics = Mechanics(Model(Holes(material=RUBBER), 1.0, "hex27_p1"))
    assert mechanics.chamber_volumes_mm3() == pytest.approx([1.0, 2.0])
    assert mechanics.chamber_volumes_mm3(stretched(mechanics, 1.5, 1.1, 1.0)) == pytest.approx([1.65, 3.3])


def test_what_has_no_mechanics_is_refused(block: Mechanics) -> None:
    known = body()
    with pytest.raises(lab.InputError, match="Only a whole body that fem=solid simulated"):
        Mechanics.of(replace(known, provenance={}))
    moved = replace(known, domain=replace(known.domain, points_mm=known.domain.points_mm + 1e-3))
    with pytest.raises(lab.InputError, match="meshes the finger otherwise"):
        Mechanics.of(Dataset(**vars(moved)))
    with pytest.raises(lab.InputError, match=r"has shape \(3, 3\); it must be \(125, 3\)"):
        block.stretches(np.zeros((3, 3)))
    with pytest.raises(lab.InputError, match="turns an element inside out"):
        block.stress_mpa(stretched(block, -1.0, 1.0, 1.0))
