"""Cavities that the clamp, the plane of symmetry or both close: what they enclose and how the air pushes."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import FacetBasis, Mesh

from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.meshcavity import chambers
from tests.meshes import WIDTH, bricks, inside, save, skin, tetrahedra

registry.discover()

HALF = (0.0, 3.0, 6.0)


@dataclass(frozen=True)
class Pocket:
    """A cavity in the body of `bricks`.

    Attributes
    ----------
    hole
        Which bricks are left out.
    walls
        Lowest and highest corner of a box that holds its walls, and nothing else of the surface but openings [mm].
    volume_mm3
        What it encloses.
    area_mm2
        Area of its openings along x, y and z, positive where the air pushes the body to that side [mm²].
    """

    hole: Callable[[int, int, int], bool]
    walls: tuple[tuple[float, ...], tuple[float, ...]]
    volume_mm3: float
    area_mm2: tuple[float, float, float]


POCKETS = {
    "closed": Pocket(lambda i, j, k: 1 <= i <= 6 and j == 1 and k == 1, ((5, -3, 5), (35, 3, 9)), 720, (0, 0, 0)),
    "clamp": Pocket(lambda i, j, k: i <= 6 and j == 1 and k == 1, ((0, -3, 5), (35, 3, 9)), 840, (24, 0, 0)),
    "hung": Pocket(lambda i, j, k: 1 <= i <= 2 and j == 1 and k >= 1, ((5, -3, 5), (15, 3, 12)), 420, (0, 0, -60)),
    "shallow": Pocket(lambda i, j, k: 1 <= i <= 2 and j == 1 and k == 2, ((5, -3, 9), (15, 3, 12)), 180, (0, 0, -60)),
    "floor": Pocket(lambda i, j, k: 1 <= i <= 2 and j == 1 and k <= 1, ((5, -3, 0), (15, 3, 9)), 540, (0, 0, 60)),
    "plane": Pocket(lambda i, j, k: 1 <= i <= 6 and j == 0 and k == 1, ((5, 0, 5), (35, 3, 9)), 360, (0, 120, 0)),
    "both": Pocket(lambda i, j, k: i <= 6 and j == 0 and k == 1, ((0, 0, 5), (35, 3, 9)), 420, (12, 140, 0)),
    "hung half": Pocket(lambda i, j, k: 1 <= i <= 2 and j == 0 and k >= 1, ((5, 0, 5), (15, 3, 12)), 210, (0, 70, -30)),
}


def finger(path: Path, pocket: Pocket, shift: tuple[float, float, float], split: bool) -> Finger:
    """The body with a pocket, somewhere in space, held at its end and around an opening above or below near there."""
    half = pocket.area_mm2[1] > 0
    points, cells = bricks(pocket.hole, ys=HALF if half else WIDTH)
    cells = tetrahedra(cells) if split else cells
    facets = skin(cells)
    middles = points[facets].mean(axis=1)
    flat = np.ptp(points[facets], axis=1) < 1e-9
    ends, sides, levels = ((middles[:, i] < 1e-9) & flat[:, i] for i in range(3))
    levels |= (middles[:, 2] > 11.99) & flat[:, 2]
    named = {"clamp": ends | (levels & (middles[:, 0] < 20) & (pocket.area_mm2[2] != 0))}
    if half:
        named["symmetry"] = sides
    named["cavity"] = inside(middles, *pocket.walls) & ~named["clamp"] & ~named.get("symmetry", np.array(False))
    cls: type[Finger] = registry.plugin("finger", "mesh")
    return cls(path=str(save(path / "a.vtu", points + shift, cells, named)), gravity_m_s2=[0.0, 0.0])  # type: ignore[call-arg]


@pytest.mark.parametrize("split", [False, True], ids=["hexahedra", "tetrahedra"])
@pytest.mark.parametrize("shift", [(0, 0, 0), (-70, 31, 12), (300, -40, -90)], ids=str)
@pytest.mark.parametrize("pocket", POCKETS.values(), ids=POCKETS)
def test_what_a_pocket_encloses(tmp_path: Path, pocket: Pocket, shift: tuple[float, float, float], split: bool) -> None:
    mesh = finger(tmp_path, pocket, shift, split).mesh(1.0)
    for placed in (mesh, mesh.translated([11.0, 0.0, -5.0]), mesh.translated(shift)):
        (found,) = chambers(placed, mesh.boundaries["cavity"])
        assert found.volume_mm3 == pytest.approx(pocket.volume_mm3, rel=1e-9)
        assert not len(found.open_edges)


@pytest.mark.parametrize("pocket", POCKETS.values(), ids=POCKETS)
def test_outer_surface_encloses_no_air(tmp_path: Path, pocket: Pocket) -> None:
    mesh = finger(tmp_path, pocket, (7, 8, 9), split=False).mesh(1.0)
    outer = np.setdiff1d(mesh.boundary_facets(), np.concatenate(list(mesh.boundaries.values())))
    for surface in chambers(mesh, outer):
        assert surface.volume_mm3 < -500  # mm³; the solid and all that it encloses


@pytest.mark.parametrize("element", ["hex20", "tet10_p0"])
@pytest.mark.parametrize("pocket", POCKETS.values(), ids=POCKETS)
def test_the_air_pushes_on_the_walls(tmp_path: Path, pocket: Pocket, element: str) -> None:
    """At rest the air pushes with p times the area of what closes the cavity; held openings leave that so."""
    model = Model(finger(tmp_path, pocket, (5, 6, 7), element.startswith("tet")), 1.0, element)
    rest = np.zeros_like(model.discretisation.positions)
    kpa = 30.0
    area = 1e-3 * kpa * np.array(pocket.area_mm2)
    np.testing.assert_allclose(model.reaction_and_load_n(rest, kpa)[1], area, atol=1e-12)
    shaken = rest + 0.05 * np.random.default_rng(0).normal(size=rest.shape) * model.equilibrium.free
    along = pocket.area_mm2[1] == 0  # the opening in the plane of symmetry is not held
    np.testing.assert_allclose(model.reaction_and_load_n(shaken, kpa)[1][along], area[along], atol=1e-12)


@pytest.mark.parametrize("pocket", ["clamp", "both"])
def test_the_support_holds_what_the_air_pushes(tmp_path: Path, pocket: str) -> None:
    model = Model(finger(tmp_path, POCKETS[pocket], (5, 6, 7), split=False), 1.0, "hex20")
    history = model.load(np.array([5.0]), 1e-9, 1e-2)
    reaction, load = model.reaction_and_load_n(history.at(5.0), 5.0)
    np.testing.assert_allclose(reaction, -load, atol=1e-9)
    assert load[0] == pytest.approx(5e-3 * POCKETS[pocket].area_mm2[0], rel=1e-9 if pocket == "clamp" else 0.05)


@pytest.mark.parametrize("pocket", POCKETS.values(), ids=POCKETS)
def test_derivative_of_the_volume_is_the_push_where_the_body_is_free(tmp_path: Path, pocket: Pocket) -> None:
    """Against the follower load in its classical form, the deformed normal by Nanson's formula."""
    model = Model(finger(tmp_path, pocket, (5, 6, 7), split=False), 1.0, "hex20")
    basis, free, rng = model.discretisation.basis, model.equilibrium.free, np.random.default_rng(1)
    displacement, field = (rng.normal(size=free.shape) * free for _ in range(2))
    displacement *= 0.1
    gradient = -Cavity(basis).response(displacement, stiffness=False).forces
    work = float((gradient.reshape(-1, 8, 3) * field[Cavity(basis).nodes]).sum())
    assert work == pytest.approx(_classical(basis.mesh, basis, displacement, field), rel=1e-6)


def _classical(mesh: Mesh, basis: "object", displacement: NDArray[np.float64], field: NDArray[np.float64]) -> float:
    walls = FacetBasis(mesh, basis.elem, facets="cavity", intorder=8)  # type: ignore[attr-defined]
    gradient = np.stack([walls.interpolate(displacement[:, i]).grad for i in range(3)]) + np.eye(3)[:, :, None, None]
    deformed = gradient.transpose(2, 3, 0, 1)
    cofactor = np.linalg.det(deformed)[..., None, None] * np.linalg.inv(deformed).transpose(0, 1, 3, 2)
    normal = np.einsum("wqij,jwq->iwq", cofactor, np.asarray(walls.normals))
    value = np.stack([np.asarray(walls.interpolate(field[:, i])) for i in range(3)])
    return -float((value * normal * walls.dx).sum())


def test_opening_to_the_outside_is_named(tmp_path: Path) -> None:
    """The pocket hung from the top, where the body is not held around its opening."""
    pocket = POCKETS["hung"]
    free = Pocket(pocket.hole, pocket.walls, pocket.volume_mm3, (0, 0, 0))
    with pytest.raises(InputError, match=r"is open along 6 edges, the first near \(.*\) mm: .* up to the clamp"):
        finger(tmp_path, free, (0, 0, 0), split=False).mesh(1.0)
