"""Whether curved faces pass through each other, on more triangles than contact follows them with.

Contact keeps triangles apart. Between their corners a face that bulges by b lies up to b / d² off them, with d
triangles along its edges: faces that bulge by a millimetre can pass through each other by 0.2 mm before their three
triangles meet. So they are looked at once more, with as many triangles as their bulge asks for.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.collision import collision_mesh, moved, thinned
from pgdl_lab.mechanics.skin import bulge, sampled

if TYPE_CHECKING:
    import ipctk

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OFF = 0.25  # of the depth that is looked for: how far triangles may lie from a face
MOST_DIVISIONS = 32  # of an edge: enough where a face bulges by 10 mm


class CurvedFaces:
    """The faces of a body, seen finely.

    Parameters
    ----------
    faces
        (F, 6, 8 or 9) nodes of each, those at one air together: these can meet.
    positions
        (N, 3) undeformed nodes [mm].
    mirror
        Whether it is the half y ≥ 0 of a body, which can meet its mirror image.
    """

    def __init__(self, faces: list[Index], positions: Array, *, mirror: bool) -> None:
        self._faces, self._positions, self._mirror = faces, positions, mirror
        self._meshes: dict[tuple[int, int], ipctk.CollisionMesh] = {}

    def off_mm(self, displacement: Array, divisions: int) -> float:
        """How far `divisions` triangles along an edge may lie from the faces at `displacement` (N, 3) [mm]."""
        at = self._positions + displacement
        return max(float(bulge(faces, at).max()) for faces in self._faces) / divisions**2

    def cross(self, displacement: Array, deeper_mm: float) -> bool:
        """Whether faces pass through each other, by more than `deeper_mm`, at `displacement` (N, 3) [mm]."""
        return any(self._crosses(number, displacement, deeper_mm) for number in range(len(self._faces)))

    def _crosses(self, number: int, displacement: Array, deeper_mm: float) -> bool:
        import ipctk

        bulging = float(bulge(self._faces[number], self._positions + displacement).max())
        mesh = self._mesh(number, int(np.clip(np.ceil((bulging / (OFF * deeper_mm)) ** 0.5), 1, MOST_DIVISIONS)))
        vertices = moved(mesh, displacement)
        if self._mirror and float(vertices[:, 1].min()) < -deeper_mm / 2:
            return True
        # Thinned by more than its thickness a thin wall would seem to pass through itself.
        met: bool = ipctk.has_intersections(mesh, vertices)
        return met and bool(ipctk.has_intersections(mesh, thinned(mesh, vertices, deeper_mm / 2)))

    def _mesh(self, number: int, divisions: int) -> "ipctk.CollisionMesh":
        if (number, divisions) not in self._meshes:
            samples = sampled(self._faces[number], self._positions, divisions)
            self._meshes[number, divisions] = collision_mesh(samples)
        return self._meshes[number, divisions]
