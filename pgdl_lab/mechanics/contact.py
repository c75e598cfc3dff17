"""Frictionless contact of the outer skin with itself, by a barrier that keeps surfaces apart.

The potential of M. Li et al., Incremental Potential Contact, ACM Transactions on Graphics 39 (2020), as the IPC Toolkit
computes it: zero where surfaces are farther apart than a small reach, growing without bound as they meet. With it a
step of Newton's method ends before the first penetration. That holds from a start without one: `penetrates` sees
surfaces that cross, but not a body that a predictor has carried wholly through another.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.elements import Discretisation, cells_of
from pgdl_lab.mechanics.vtk import ordered_cells

if TYPE_CHECKING:
    import ipctk
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]


# Of each face its corners, middle nodes and, of 27-node hexahedra only, centre, as places in what
# `pgdl_lab.mechanics.vtk.ordered_cells` gives.
HEXAHEDRON = np.array(
    [
        [0, 4, 7, 3, 16, 15, 19, 11, 20],
        [1, 2, 6, 5, 9, 18, 13, 17, 21],
        [0, 1, 5, 4, 8, 17, 12, 16, 22],
        [3, 7, 6, 2, 19, 14, 18, 10, 23],
        [0, 3, 2, 1, 11, 10, 9, 8, 24],
        [4, 5, 6, 7, 12, 13, 14, 15, 25],
    ]
)
TETRAHEDRON = np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]])
# Triangles of a face on its own nodes, numbered as in a row above.
AROUND_CENTRE = np.array([[a, b, 8] for a, b in [(0, 4), (4, 1), (1, 5), (5, 2), (2, 6), (6, 3), (3, 7), (7, 0)]])
WITHOUT_CENTRE = np.array([[0, 4, 7], [1, 5, 4], [2, 6, 5], [3, 7, 6], [4, 5, 6], [4, 6, 7]])
ON_TETRAHEDRON = np.array([[0, 3, 5], [1, 4, 3], [2, 5, 4], [3, 4, 5]])


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

        triangles = skin(discretisation)
        self.mode = mode
        self.active = mode == "on"
        self.reach_mm = reach_mm
        self._mesh = ipctk.CollisionMesh.build_from_full_mesh(
            np.asfortranarray(discretisation.positions), ipctk.edges(triangles), triangles
        )
        self._potential = ipctk.BarrierPotential(reach_mm, stiffness_mpa, use_physical_barrier=True)
        # Elements of the skin that share no node may be near each other at rest: a step, or the bottom of a gap.
        self._rest_mm = float("inf")
        self._rest_mm = self.gap_mm(np.zeros_like(discretisation.positions))
        if reach_mm >= self._rest_mm / 2:
            raise InputError(
                f"fem.contact_mm is {reach_mm} mm; it must be below half of {self._rest_mm:.3g} mm, the smallest "
                "distance between surfaces of the undeformed mesh."
            )

    def response(self, displacement: Array, *, hessian: bool) -> ContactResponse:
        """Energy, forces and, if asked for, stiffness at a `displacement` (N, 3) [mm] without penetration."""
        vertices = self._vertices(displacement)
        collisions = self._collisions(vertices, self.reach_mm)
        energy = float(self._potential(collisions, self._mesh, vertices))
        forces = self._mesh.to_full_dof(self._potential.gradient(collisions, self._mesh, vertices))
        stiffness = None
        if hessian:
            stiffness = self._mesh.to_full_dof(self._potential.hessian(collisions, self._mesh, vertices)).tocsr()
        return ContactResponse(energy, forces.reshape(displacement.shape), stiffness)

    def free_step(self, displacement: Array, correction: Array) -> float:
        """Largest part of `correction`, at most 1, that can be added to `displacement` before surfaces meet."""
        import ipctk

        # The additive method ends soon also where nodes face each other exactly; the default one may not.
        step: float = ipctk.compute_collision_free_stepsize(
            self._mesh,
            self._vertices(displacement),
            self._vertices(displacement + correction),
            narrow_phase_ccd=ipctk.AdditiveCCD(),
        )
        return step if step == 1 else 0.9 * step

    def penetrates(self, displacement: Array) -> bool:
        """Whether surfaces pass through each other at `displacement` (N, 3) [mm]."""
        import ipctk

        crossed: bool = ipctk.has_intersections(self._mesh, self._vertices(displacement))
        return crossed

    def touches(self, displacement: Array) -> bool:
        """Whether surfaces are within reach of each other, or have passed through each other."""
        near = not self._collisions(self._vertices(displacement), self.reach_mm).empty()
        return near or self.penetrates(displacement)

    def gap_mm(self, displacement: Array) -> float:
        """Smallest distance between surfaces [mm]; infinite when they are farther than half of that at rest."""
        vertices = self._vertices(displacement)
        collisions = self._collisions(vertices, min(self._rest_mm / 2, 20 * self.reach_mm))
        if collisions.empty():
            return float("inf")
        return float(collisions.compute_minimum_distance(self._mesh, vertices)) ** 0.5

    def _vertices(self, displacement: Array) -> Array:
        vertices: Array = self._mesh.displace_vertices(np.asfortranarray(displacement))
        return vertices

    def _collisions(self, vertices: Array, reach_mm: float) -> "ipctk.NormalCollisions":
        import ipctk

        collisions = ipctk.NormalCollisions()
        collisions.use_area_weighting = True
        collisions.build(self._mesh, vertices, reach_mm)
        return collisions


def skin(discretisation: Discretisation) -> NDArray[np.int32]:
    """Triangles (T, 3) on the nodes of all boundary facets that are not part of a named boundary."""
    mesh = discretisation.basis.mesh
    facets = np.setdiff1d(mesh.boundary_facets(), np.concatenate(list((mesh.boundaries or {}).values())))
    cells = ordered_cells(discretisation)
    owner = cells[mesh.f2t[0, facets]]
    wanted = np.sort(discretisation.basis.nodal_dofs[0, mesh.facets[:, facets]].T, axis=1)
    if cells_of(mesh) == "tetrahedra":
        # Without the centre of a 15-node element's face: smaller triangles lie nearer to each other at rest.
        faces, split = TETRAHEDRON, ON_TETRAHEDRON
    elif cells.shape[1] == 20:
        faces, split = HEXAHEDRON[:, :8], WITHOUT_CENTRE
    else:
        faces, split = HEXAHEDRON, AROUND_CENTRE
    corners = np.sort(owner[:, faces[:, : len(mesh.facets)]], axis=2)
    face = (corners == wanted[:, None]).all(axis=2).argmax(axis=1)
    triangles = np.take_along_axis(owner, faces[face], axis=1)[:, split]
    return triangles.reshape(-1, 3).astype(np.int32)
