"""Segments of a finger between cuts, and how stiff each is as a piece of a rod.

Sections of a finger with chambers and gaps do not stay plane: a wall beside a gap bears little stress, and pressure
bends walls. With the stiffnesses of its columns in series pneunet would be some four times too stiff. Sections do stay
plane where the finger mirrors itself, as it does in the middle of a gap in a row of equal chambers. So the finger is
cut there, and each segment between two cuts is solved once, in three dimensions and at small strain, with its cuts
plane and free of shear. With u_i the displacement for a unit of the strain i, K the stiffness of the elements, f the
nodal forces of a unit pressure on the walls, o what that does in the opening of a cut and l the length of the segment,
the rod's stiffness and the force and moment of the air are

    C_ij = u_i·K u_j / l,    a_i = u_i·f / l + o_i,

the homogenisation of a periodic rod (W. Yu, Journal of Mechanics of Materials and Structures 11, 2016), where each
segment is taken for a period of its own. For a prismatic piece this is E A, E I and the neutral line of the textbooks;
a prismatic cavity has 1 − 2 ν times its area and first moment, since its walls also pull the ends together.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.assembly import Assembler
from pgdl_lab.mechanics.elements import BEST, ELEMENTS, Discretisation, discretise
from pgdl_lab.mechanics.extrude import extrude
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.lattice import Lattice
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.profile import Profile, Region
from pgdl_lab.mechanics.solid import Solid

Array = NDArray[np.float64]

STIFFENING = 2.0  # gaps that walls bulge over by small strains before they meet: in truth they stiffen, and bulge less


@dataclass(frozen=True)
class Segment:
    """A segment as a piece of rod, and the shape that its side face takes.

    Its strains are the stretch Γ of the axis less 1 [–] and its curvature κ [1/mm], positive when it turns from x to z.

    Attributes
    ----------
    stiffness
        (2, 2) normal force [N] and moment [N mm] per strain.
    air
        (2,) normal force [mm²] and moment [mm³] of the air per pressure.
    lattice
        Places on the side face, x from the left cut.
    shapes
        (3, places, 2) displacement along x and z on the side face in excess of a rod's: per Γ [mm], per κ [mm²] and per
        pressure [mm/MPa]; 0 at the lower end of the left cut, and at places in gaps.
    left, right
        The walls that face the cuts.
    """

    stiffness: Array
    air: Array
    lattice: Lattice
    shapes: Array
    left: "Wall"
    right: "Wall"


@dataclass(frozen=True)
class Wall:
    """A wall across a gap from a cut, and how it bulges towards it.

    Attributes
    ----------
    gap_mm
        From the wall to the cut [mm]; infinite where there is no gap.
    bulge
        (3, n) of its nodes: per Γ [mm], per κ [mm²] and per pressure [mm/MPa].
    """

    gap_mm: float
    bulge: Array

    def bulge_mm(self, amplitudes: Array) -> float:
        """How far it bulges at Γ [–], κ [1/mm] and a pressure [MPa] (3,), if it does not stiffen."""
        return float((amplitudes @ self.bulge).max(initial=0.0))


def meet(segments: list[Segment], amplitudes: Array) -> bool:
    """Whether walls of neighbouring `segments` meet at Γ [–], κ [1/mm] and a pressure [MPa] of each (segments, 3)."""
    return any(
        one.right.bulge_mm(a) + other.left.bulge_mm(b) > STIFFENING * (one.right.gap_mm + other.left.gap_mm)
        for (one, a), (other, b) in pairwise(zip(segments, amplitudes, strict=True))
    )


def walls(piece: Profile, body: Discretisation, fields: Array, axis_mm: float) -> tuple[Wall, Wall]:
    """The walls that face the left and the right cut of a segment, by its `fields` (3, N, 3)."""
    x, _, z = body.positions.T
    found, length = [], piece.x[-1]
    for column, side in ((0, -1), (-1, 1)):
        open_above = piece.z[:-1][piece.regions[column] == Region.GAP].min(initial=np.inf)
        high = z > open_above + 1e-9
        if not high.any():
            found.append(Wall(np.inf, np.zeros((3, 0))))
            continue
        place = side * float((side * x[high]).max())
        wall = high & np.isclose(x, place)
        moved = fields[:, wall, 0].copy()
        if side > 0:  # the cut itself moves, in one plane
            moved[0] -= length
            moved[1] += length * (z[wall] - axis_mm)
        found.append(Wall(length - place if side > 0 else place, side * moved))
    return found[0], found[1]


def columns(profile: Profile) -> Iterator[tuple[float, float, NDArray[np.int8]]]:
    """Start and end [mm] of each column of `profile` and its regions (nz,); equal neighbours count as one."""
    changes = np.flatnonzero((np.diff(profile.regions, axis=0) != 0).any(axis=1)) + 1
    bounds = [0, *changes, len(profile.regions)]
    for start, stop in zip(bounds[:-1], bounds[1:], strict=True):
        yield profile.x[start], profile.x[stop], profile.regions[start]


def cuts(profile: Profile) -> Array:
    """Where the finger is cut [mm]: at its ends, in the middle of gaps and of columns that are longer than high."""
    height = profile.z[-1] - profile.z[0]
    middles = [
        (start + stop) / 2
        for start, stop, regions in columns(profile)
        if (regions == Region.GAP).any() or stop - start > height
    ]
    return np.array([profile.x[0], *middles, profile.x[-1]])


def between(profile: Profile, start: float, stop: float) -> Profile:
    """The part of `profile` from `start` to `stop` [mm], moved to x = 0."""
    inside = (profile.x > start + 1e-9) & (profile.x < stop - 1e-9)
    x = np.array([start, *profile.x[inside], stop])
    return Profile(x - start, profile.z, profile.regions[np.searchsorted(profile.x, (x[1:] + x[:-1]) / 2) - 1])


def segments(finger: ExtrudedFinger, places: Array, edge_mm: float, axis_mm: float) -> list[Segment]:
    """The segments between the cuts at `places` (n + 1,) [mm]; those that are alike are solved only once.

    Parameters
    ----------
    edge_mm
        Longest edge of the elements [mm].
    axis_mm
        Height z of the rod's axis [mm].
    """
    profile, known, result = finger.profile(), {}, []
    for number, (start, stop) in enumerate(zip(places[:-1], places[1:], strict=True)):
        piece, clamped = between(profile, start, stop), number == 0
        key = (clamped, *np.round(piece.x, 9), piece.regions.tobytes())
        if key not in known:
            known[key] = solve(finger, piece, clamped, edge_mm, axis_mm)
        result.append(known[key])
    return result


def solve(finger: ExtrudedFinger, piece: Profile, clamped: bool, edge_mm: float, axis_mm: float) -> Segment:
    """Solve for one segment of `finger`; `clamped`: its left end is held and not a cut."""
    halvings = finger.profile().halvings(edge_mm)
    mesh = extrude(piece, finger.width_mm / 2, finger.side_wall_mm, edge_mm, halvings=halvings)
    body = discretise(mesh, ELEMENTS[BEST["hexahedra"]])
    x, y, z = body.positions.T
    length = float(piece.x[-1])
    left, right = np.isclose(x, 0), np.isclose(x, length)
    free = np.ones(body.positions.shape, dtype=bool)
    free[left | right, 0] = False
    free[np.isclose(y, 0), 1] = False
    free[left if clamped else left & np.isclose(y, 0) & np.isclose(z, z.min()), 2] = False
    if clamped:
        free[left, 1] = False

    rest = np.zeros(body.positions.shape)
    matrices = Solid(body, finger.material).response(rest, stiffness=True).stiffness
    assert matrices is not None
    assembler = Assembler([body.nodes], free)
    air = wall_forces(body)

    def forces(displacement: Array) -> Array:
        nodal = displacement[body.nodes].reshape(len(body.nodes), -1)
        return assembler.vector(np.einsum("eij,ej->ei", matrices, nodal))

    fields = np.zeros((3, *rest.shape))  # for a unit of Γ, of κ and of pressure
    fields[0, right, 0] = length
    fields[1, right, 0] = -length * (z[right] - axis_mm)
    solver = symmetric_solver()
    solver.factorise(assembler.upper(matrices))
    for number, load in enumerate([-forces(fields[0]), -forces(fields[1]), air]):
        fields[number, free] = solver.solve(load[free])
    solver.close()
    # Twice what the meshed half of the finger does.
    stiffness = np.array([[2 / length * (u * forces(v)).sum() for u in fields[:2]] for v in fields[:2]])
    push = np.array([2 / length * (u * air).sum() for u in fields[:2]])
    push += opening(piece, finger.width_mm - 2 * finger.side_wall_mm, axis_mm)
    shapes = side_shapes(piece.refined(edge_mm, halvings), body, fields, axis_mm)
    return Segment(stiffness, push, *shapes, *walls(piece, body, fields, axis_mm))


def wall_forces(body: Discretisation) -> Array:
    """Nodal forces (N, 3) of the air on the undeformed walls per pressure [mm²]."""
    import skfem

    mesh, forces = body.basis.mesh, np.zeros(body.positions.shape)
    if len(mesh.boundaries["cavity"]):
        walls = skfem.FacetBasis(mesh, body.basis.elem, facets="cavity", intorder=2)
        for component in range(3):
            forces[:, component] = skfem.LinearForm(lambda v, w, i=component: -w.n[i] * v).assemble(walls)
    return forces


def opening(piece: Profile, width_mm: float, axis_mm: float) -> Array:
    """Normal force [mm²] and moment [mm³] per pressure of the air in the openings of the right cut."""
    heights = np.diff(piece.z) * (piece.regions[-1] == Region.CAVITY)
    middles = (piece.z[1:] + piece.z[:-1]) / 2
    return width_mm * np.array([heights.sum(), -(heights * (middles - axis_mm)).sum()])


def side_shapes(grid: Profile, body: Discretisation, fields: Array, axis_mm: float) -> tuple[Lattice, Array]:
    """Places on the side face, and `fields` (3, N, 3) there less those of a rod."""
    lattice = Lattice(grid)
    outer = np.flatnonzero(np.isclose(body.positions[:, 1], body.positions[:, 1].max()))
    x, _, z = body.positions[outer].T
    excess = fields[:, outer][:, :, [0, 2]]
    excess[0, :, 0] -= x
    excess[1] -= np.column_stack([-x * (z - axis_mm), x**2 / 2])
    corner = np.flatnonzero(np.isclose(x, 0) & np.isclose(z, z.min()))
    shapes = np.zeros((3, len(lattice.x) * len(lattice.z), 2))
    shapes[:, lattice.nearest(x, z)] = excess - excess[:, corner]
    return lattice, shapes
