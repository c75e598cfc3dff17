"""Frictionless contact of the outer skin with itself, by a barrier that keeps surfaces apart.

The potential of M. Li et al., Incremental Potential Contact, ACM Transactions on Graphics 39 (2020), as the IPC Toolkit
computes it: zero where surfaces are farther apart than a small reach, growing without bound as they meet. With it a
step of Newton's method ends before the first penetration. That holds from a start without one, which only the way
there can show: a body carried wholly through another crosses nothing at the end of it.
"""

from dataclasses import dataclass
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


# The continuous collision detection steps on by what surfaces are apart; without a limit it steps for minutes where
# they all but touch. Beyond the limit it takes them to meet, which is safe.
MOST_ADVANCES = 2000
# Forces on quadratic faces come from samples, more of them than nodes: those of a uniform pressure are in error by the
# square of the distance of samples. Where faces are too narrow for three to an edge, two must do.
DIVISIONS = (3, 2)


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
        self._potential = ipctk.BarrierPotential(reach_mm, stiffness_mpa, use_physical_barrier=True)
        rest = np.zeros_like(discretisation.positions)
        for divisions in DIVISIONS:
            self._mesh = sampled(faces, discretisation.positions, divisions)
            # Triangles that share no vertex may be near each other at rest: a step, or the bottom of a gap.
            self._rest_mm = 4 * reach_mm
            near_mm = self.gap_mm(rest)
            if not np.isfinite(near_mm):
                break
        else:
            raise InputError(
                f"fem.contact_mm is {reach_mm} mm; it must be below half of {near_mm:.3g} mm, the smallest distance "
                "between surfaces of the undeformed mesh."
            )
        self._rest_mm = 40 * reach_mm
        self._rest_mm = min(self.gap_mm(rest), self._rest_mm)

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
        corners = self._flat.displace_vertices(np.asfortranarray(displacement))
        apart = self.reach_mm + 2 * bulge(self._faces, self._positions + displacement)
        if collisions(self._flat, corners, apart).empty():
            return False
        return not collisions(self._mesh, self._vertices(displacement), self.reach_mm).empty()

    def gap_mm(self, displacement: Array) -> float:
        """Smallest distance between surfaces [mm]; infinite when they are farther than half of that at rest."""
        vertices = self._vertices(displacement)
        found = collisions(self._mesh, vertices, self._rest_mm / 2)
        return float("inf") if found.empty() else float(found.compute_minimum_distance(self._mesh, vertices)) ** 0.5

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


class NoContact(Contact):
    """Contact that never acts, and needs no skin."""

    def __init__(self) -> None:
        self.mode, self.active = "off", False
