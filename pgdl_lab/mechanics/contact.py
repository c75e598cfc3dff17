"""Frictionless contact of the outer skin with itself, by a barrier that keeps surfaces apart.

The potential of M. Li et al., Incremental Potential Contact, ACM Transactions on Graphics 39 (2020), as the IPC Toolkit
computes it: zero where surfaces are farther apart than a small reach, growing without bound as they meet. With it a
step of Newton's method ends before the first penetration. That holds from a start without one, which only the way
there can show: a body carried wholly through another crosses nothing at the end of it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.elements import Discretisation
from pgdl_lab.mechanics.skin import bulge, sampled, skin

if TYPE_CHECKING:
    import ipctk
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]


REACH_MM = 0.05  # unless told otherwise
# The continuous collision detection steps on by what surfaces are apart; without a limit it steps for minutes where
# they all but touch. Beyond the limit it takes them to meet, which is safe.
MOST_ADVANCES = 2000
# Forces on quadratic faces come from samples, more of them than nodes: those of a uniform pressure are in error by the
# square of the distance of samples. Where faces are too narrow for three to an edge, two must do.
DIVISIONS = (3, 2)
WIDEST_GAP = 10  # reaches: gaps up to it are measured
MOST_PAIRS = 200  # of the flat skin that are looked at one by one; more take longer than a look at the fine skin


@dataclass(frozen=True)
class ContactResponse:
    """The barrier and its derivatives.

    Attributes
    ----------
    energy
        Potential of the contact [N mm].
    forces
        (N, 3) its gradient [N].
    stiffness
        (3 N, 3 N) its Hessian [N/mm]; None if not asked for.
    """

    energy: float
    forces: Array
    stiffness: "csr_matrix | None"


class Contact:
    """The skin of a body: all of its boundary but the named parts.

    Parameters
    ----------
    discretisation
        The elements.
    reach_mm
        Distance below which surfaces push each other apart [mm].
    stiffness_mpa
        Scale of the contact pressure [MPa].
    mode
        "on": the barrier acts from the start; "auto": whoever finds that surfaces touch sets `active`; "off": it never
        acts, and surfaces may pass through each other.
    """

    def __init__(self, discretisation: Discretisation, reach_mm: float, stiffness_mpa: float, mode: str) -> None:
        import ipctk

        faces = skin(discretisation)
        self.mode = mode
        self.active = mode == "on"
        self.reach_mm = reach_mm
        self._faces, self._positions = faces, discretisation.positions
        self._flat = sampled(faces, discretisation.positions, 1)
        self._flat_corners = self._flat.faces.reshape(len(faces), -1)
        self._potential = ipctk.BarrierPotential(reach_mm, stiffness_mpa, use_physical_barrier=True)
        for divisions in DIVISIONS:
            self._mesh = sampled(faces, discretisation.positions, divisions)
            # Triangles that share no vertex may be near each other at rest: a step, or the bottom of a gap.
            near_mm = smallest_distance(self._mesh, self._mesh.rest_positions, 2 * reach_mm)
            if not np.isfinite(near_mm):
                break
        else:
            raise InputError(
                f"fem.contact_mm is {reach_mm} mm; it must be below half of {near_mm:.3g} mm, the smallest distance "
                "between surfaces of the undeformed mesh."
            )

    @cached_property
    def _seen_mm(self) -> float:
        """Distance up to which gaps are told from what is near at rest [mm]."""
        farthest = WIDEST_GAP * self.reach_mm
        return min(smallest_distance(self._mesh, self._mesh.rest_positions, 2 * farthest) / 2, farthest)

    def response(self, displacement: Array, *, hessian: bool) -> ContactResponse:
        """Energy, forces and, if asked for, stiffness at a `displacement` (N, 3) [mm] without penetration."""
        vertices = self._vertices(displacement)
        touching = collisions(self._mesh, vertices, self.reach_mm)
        energy = float(self._potential(touching, self._mesh, vertices))
        forces = self._mesh.to_full_dof(self._potential.gradient(touching, self._mesh, vertices))
        stiffness = None
        if hessian:
            stiffness = self._mesh.to_full_dof(self._potential.hessian(touching, self._mesh, vertices)).tocsr()
        return ContactResponse(energy, forces.reshape(displacement.shape), stiffness)

    def free_step(self, displacement: Array, correction: Array) -> float:
        """Largest part of `correction`, at most 1, that can be added to `displacement` before surfaces meet."""
        import ipctk

        # The additive method ends soon also where nodes face each other exactly; the default one may not.
        step: float = ipctk.compute_collision_free_stepsize(
            self._mesh,
            self._vertices(displacement),
            self._vertices(displacement + correction),
            narrow_phase_ccd=ipctk.AdditiveCCD(MOST_ADVANCES),
        )
        return step if step == 1 else 0.9 * step

    def passes(self, start: Array, end: Array) -> bool:
        """Whether surfaces meet on the straight way between two displacements (N, 3) [mm].

        The way of each node is a chord of its true path, so that a long one may seem to meet what a short one passes.
        The faces are taken as flat between their corners: enough to see a body pass, in a fifth of the time.
        """
        import ipctk

        ways = [self._flat.displace_vertices(np.asfortranarray(displacement)) for displacement in (start, end)]
        free: bool = ipctk.is_step_collision_free(
            self._flat, *ways, narrow_phase_ccd=ipctk.AdditiveCCD(MOST_ADVANCES, 0.999)
        )
        return not free

    def penetrates(self, displacement: Array) -> bool:
        """Whether surfaces pass through each other at `displacement` (N, 3) [mm]."""
        import ipctk

        crossed: bool = ipctk.has_intersections(self._mesh, self._vertices(displacement))
        return crossed

    def near(self, displacement: Array) -> bool:
        """Whether surfaces are within reach of each other."""
        if self._apart(displacement, self.reach_mm):
            return False
        return not collisions(self._mesh, self._vertices(displacement), self.reach_mm).empty()

    def gap_mm(self, displacement: Array) -> float:
        """Smallest distance between surfaces [mm]; infinite when they are farther than half of that at rest."""
        if self._apart(displacement, self._seen_mm):
            return float("inf")
        return smallest_distance(self._mesh, self._vertices(displacement), self._seen_mm)

    def _apart(self, displacement: Array, distance_mm: float) -> bool:
        """Whether it is sure, without a look at the fine skin, that surfaces are farther than `distance_mm` apart."""
        corners = self._flat.displace_vertices(np.asfortranarray(displacement))
        off = bulge(self._faces, self._positions + displacement)
        found = collisions(self._flat, corners, distance_mm + 2 * float(off.max()))
        if len(found) > MOST_PAIRS:
            return False
        at_vertices = np.zeros(len(corners))
        np.maximum.at(at_vertices, self._flat_corners, off[:, None])
        edges, triangles = self._flat.edges, self._flat.faces
        for pair in (found[number] for number in range(len(found))):
            apart = pair.compute_distance(pair.dof(corners, edges, triangles)) ** 0.5
            vertices = [vertex for vertex in pair.vertex_ids(edges, triangles) if vertex >= 0]
            if apart <= distance_mm + 2 * at_vertices[vertices].max():
                return False
        return True

    def _vertices(self, displacement: Array) -> Array:
        vertices: Array = self._mesh.displace_vertices(np.asfortranarray(displacement))
        return vertices


def collisions(mesh: "ipctk.CollisionMesh", vertices: Array, reach_mm: float) -> "ipctk.NormalCollisions":
    """What is nearer than `reach_mm` [mm] on `mesh` with its `vertices` (V, 3) [mm]."""
    import ipctk

    found = ipctk.NormalCollisions()
    found.use_area_weighting = True
    found.build(mesh, vertices, reach_mm)
    return found


def smallest_distance(mesh: "ipctk.CollisionMesh", vertices: Array, farthest_mm: float) -> float:
    """The smallest distance [mm] on `mesh` with its `vertices` (V, 3) [mm]; infinite beyond `farthest_mm`."""
    found = collisions(mesh, vertices, farthest_mm)
    return float("inf") if found.empty() else float(found.compute_minimum_distance(mesh, vertices)) ** 0.5


class NoContact(Contact):
    """Contact that never acts, and needs no skin."""

    def __init__(self) -> None:
        self.mode, self.active = "off", False
