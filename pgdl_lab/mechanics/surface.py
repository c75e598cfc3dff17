"""What can meet: the faces at one air each other, and half a body its mirror image; and what pushes them apart."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from copy import copy
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.collision import collision_mesh, collisions, each, ends, moved
from pgdl_lab.mechanics.skin import bulge, sampled
from pgdl_lab.mechanics.term import Response
from pgdl_lab.mechanics.through_air import shut_out_body

if TYPE_CHECKING:
    from typing import Self

    import ipctk
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# The continuous collision detection steps on by what surfaces are apart; without a limit it steps for minutes where
# they all but touch. Beyond the limit it takes them to meet, which is safe.
MOST_ADVANCES = 2000
MOST_PAIRS = 200  # of the flat surface that are looked at one by one; more take longer than a look at the fine one


class Pairs(ABC):
    """Pairs of samples, edges and triangles that can meet.

    Parameters
    ----------
    mesh
        Where they are.
    part
        Of a gap that is the distance of its pair [–].
    reach_mm
        Gap below which a pair is pushed apart [mm].
    stiffness_mpa
        Scale of the contact pressure [MPa].

    Attributes
    ----------
    apart_at_rest_mm
        Smallest gap of the undeformed mesh [mm]; infinite beyond twice the reach.
    touching_at_rest, remedy
        What to say, as parts of a sentence, of a body that has no gap at rest.
    """

    apart_at_rest_mm: float
    touching_at_rest: ClassVar[str]
    remedy: ClassVar[str]

    def __init__(self, mesh: "ipctk.CollisionMesh", part: float, reach_mm: float, stiffness_mpa: float) -> None:
        import ipctk

        self._mesh, self._part, self._reach_mm = mesh, part, reach_mm
        self._potential = ipctk.BarrierPotential(part * reach_mm, stiffness_mpa, use_physical_barrier=True)

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        """Energy, forces and, if asked for, stiffness at a `displacement` (N, 3) [mm] without penetration."""
        mesh, vertices = self._mesh, moved(self._mesh, displacement)
        touching = collisions(mesh, vertices, self._part * self._reach_mm)
        energy = float(self._potential(touching, mesh, vertices))
        forces = mesh.to_full_dof(self._potential.gradient(touching, mesh, vertices))
        hessian = mesh.to_full_dof(self._potential.hessian(touching, mesh, vertices)).tocsr() if stiffness else None
        return Response(energy, forces.reshape(displacement.shape), hessian)

    def free_step(self, displacement: Array, correction: Array) -> float:
        """Largest part of `correction`, at most 1, that can be added to `displacement` before a pair meets."""
        import ipctk

        # The additive method ends soon also where nodes face each other exactly; the default one may not.
        step: float = ipctk.compute_collision_free_stepsize(
            self._mesh,
            moved(self._mesh, displacement),
            moved(self._mesh, displacement + correction),
            narrow_phase_ccd=ipctk.AdditiveCCD(MOST_ADVANCES),
        )
        return step

    def near(self, displacement: Array) -> bool:
        """Whether a pair is within reach at `displacement` (N, 3) [mm]."""
        return self.gap_mm(displacement, self._reach_mm) < np.inf

    def gap_mm(self, displacement: Array, farthest_mm: float) -> float:
        """Smallest gap at `displacement` (N, 3) [mm]; infinite beyond `farthest_mm`."""
        vertices = moved(self._mesh, displacement)
        found = collisions(self._mesh, vertices, self._part * farthest_mm)
        if found.empty():
            return np.inf
        return float(found.compute_minimum_distance(self._mesh, vertices)) ** 0.5 / self._part

    def carried(self, interpolation: "Callable[[Array], csr_matrix]") -> "Self":
        """The same pairs, moved by other nodes: `interpolation` (V, M) from theirs to undeformed places (V, 3) [mm].

        Only what pushes them apart is carried over: `response` and `free_step`.
        """
        import ipctk

        result, mesh, at = copy(self), self._mesh, np.asfortranarray(self._mesh.rest_positions)
        result._mesh = ipctk.CollisionMesh(at, mesh.edges, mesh.faces, interpolation(at).tocsc())
        result._mesh.vertex_areas, result._mesh.planes = mesh.vertex_areas, mesh.planes
        result._mesh.can_collide = mesh.can_collide
        return result

    @abstractmethod
    def passes(self, start: Array, end: Array) -> bool:
        """Whether a pair meets on the straight way between two displacements (N, 3) [mm]."""

    @abstractmethod
    def penetrates(self, displacement: Array) -> bool:
        """Whether a pair has crossed at `displacement` (N, 3) [mm]."""


class Surface(Pairs):
    """Faces at one air, which can meet each other.

    Parameters
    ----------
    faces
        (F, 6, 8 or 9) nodes of each.
    positions
        (N, 3) undeformed nodes [mm].
    divisions
        Triangles along each edge.
    """

    touching_at_rest = "Surfaces of the undeformed mesh touch or cross each other"
    remedy = "merge nodes that coincide"

    def __init__(self, faces: Index, positions: Array, divisions: int, reach_mm: float, stiffness_mpa: float) -> None:
        self.samples = sampled(faces, positions, divisions)
        super().__init__(collision_mesh(self.samples), 1.0, reach_mm, stiffness_mpa)
        self.areas: Array = self._mesh.vertex_areas
        self.apart_at_rest_mm = shut_out_body(self._mesh, 2 * reach_mm)
        self._faces, self._positions = faces, positions
        self._flat = collision_mesh(sampled(faces, positions, 1))
        self._flat_corners = self._flat.faces.reshape(len(faces), -1)

    def passes(self, start: Array, end: Array) -> bool:
        """As for all `Pairs`.

        The way of each node is a chord of its true path, so that a long one may seem to meet what a short one passes.
        The faces are taken as flat between their corners: enough to see a body pass, in a fifth of the time.
        """
        import ipctk

        ways = [moved(self._flat, displacement) for displacement in (start, end)]
        free: bool = ipctk.is_step_collision_free(
            self._flat, *ways, narrow_phase_ccd=ipctk.AdditiveCCD(MOST_ADVANCES, 0.999)
        )
        return not free

    def penetrates(self, displacement: Array) -> bool:
        import ipctk

        crossed: bool = ipctk.has_intersections(self._mesh, moved(self._mesh, displacement))
        return crossed

    def gap_mm(self, displacement: Array, farthest_mm: float) -> float:
        if self._apart(displacement, farthest_mm):
            return np.inf
        return super().gap_mm(displacement, farthest_mm)

    def _apart(self, displacement: Array, distance_mm: float) -> bool:
        """Whether it is sure, without a look at the fine surface, that faces are farther than `distance_mm` apart."""
        corners = moved(self._flat, displacement)
        off = bulge(self._faces, self._positions + displacement)
        found = collisions(self._flat, corners, distance_mm + 2 * float(off.max()))
        if len(found) > MOST_PAIRS:
            return False
        at_vertices = np.zeros(len(corners))
        np.maximum.at(at_vertices, self._flat_corners, off[:, None])

        def may_be_nearer(pair: "ipctk.NormalCollision") -> bool:
            apart = pair.compute_distance(corners, self._flat.edges, self._flat.faces) ** 0.5
            return bool(apart <= distance_mm + 2 * at_vertices[ends(pair, self._flat)].max())

        return not any(each(found, may_be_nearer))


class MirrorPlane(Pairs):
    """Half a body y ≥ 0 and its mirror image, which meet at y = 0.

    The plane is half as far as the image. Each half has half of the energy, which is that of the barrier at half the
    reach.

    Parameters
    ----------
    surfaces
        Whose samples are off the plane.
    held
        (N,) bool, which nodes stay in it.
    """

    touching_at_rest = "Faces of the undeformed mesh lie in the plane of symmetry, and so does their mirror image"
    remedy = "put them into its group"

    def __init__(self, surfaces: list[Surface], held: NDArray[np.bool_], reach_mm: float, stiffness_mpa: float) -> None:
        import ipctk
        import scipy.sparse as sp

        interpolation = sp.vstack([surface.samples.interpolation for surface in surfaces], format="csr")
        off = abs(interpolation) @ ~held > 0
        positions = np.concatenate([surface.samples.positions for surface in surfaces])[off]
        mesh = ipctk.CollisionMesh(np.asfortranarray(positions), displacement_map=interpolation[off].tocsc())
        mesh.vertex_areas = np.concatenate([surface.areas for surface in surfaces])[off]
        mesh.planes = [ipctk.Hyperplane(np.array([0.0, 1.0, 0.0]), np.zeros(3))]
        mesh.can_collide = ipctk.make_vertex_patches_filter(np.zeros(len(positions), dtype=np.int32))  # not each other
        super().__init__(mesh, 0.5, reach_mm, stiffness_mpa)
        gap_mm = max(0.0, 2 * positions[:, 1].min())
        self.apart_at_rest_mm = gap_mm if gap_mm < 2 * reach_mm else np.inf

    def passes(self, start: Array, end: Array) -> bool:
        return self.penetrates(end)

    def penetrates(self, displacement: Array) -> bool:
        return self._lowest(displacement) < 0

    def gap_mm(self, displacement: Array, farthest_mm: float) -> float:
        gap = max(0.0, self._lowest(displacement) / self._part)
        return gap if gap < farthest_mm else np.inf

    def _lowest(self, displacement: Array) -> float:
        return float(moved(self._mesh, displacement)[:, 1].min())
