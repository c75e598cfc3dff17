"""The mesh that fields live on: the whole body, or the side face that is observed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.simplices import AXES, Floats, Ints, SimplexMesh

NONE: Ints = np.empty(0, dtype=np.int64)

# Tetrahedra between the corners of a hexahedron, all of which share its diagonal from 0 to 6.
SIX = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])
# Corners of the eight parts of a hexahedron with 27 nodes, and tetrahedra between the 10 nodes of a quadratic one; both
# in the order of VTK.
EIGHT = np.array(
    [
        [0, 8, 24, 11, 16, 22, 26, 20], [8, 1, 9, 24, 22, 17, 21, 26], [24, 9, 2, 10, 26, 21, 18, 23],
        [11, 24, 10, 3, 20, 26, 23, 19], [16, 22, 26, 20, 4, 12, 25, 15], [22, 17, 21, 26, 12, 5, 13, 25],
        [26, 21, 18, 23, 25, 13, 6, 14], [20, 26, 23, 19, 15, 25, 14, 7],
    ]
)  # fmt: skip
WITHIN = np.array(
    [[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3], [4, 5, 6, 7], [4, 5, 7, 8], [5, 6, 7, 9], [5, 7, 8, 9]]
)
PARTS = {
    "triangle": np.array([[0, 1, 2]]),
    "tetra": np.array([[0, 1, 2, 3]]),
    "tetra10": WITHIN,
    "hexahedron": SIX,
    "hexahedron20": SIX,
    "hexahedron27": EIGHT[:, SIX].reshape(-1, 4),
}
"""Simplices between the nodes of an element, by its name in meshio; of 20 nodes only the corners count."""


@dataclass(frozen=True, eq=False)  # each is its own key where something is prepared for it
class Domain:
    """A mesh in the plane or in space.

    Attributes
    ----------
    points_mm
        (N, d) float64, undeformed points: x and z of the side face (d = 2), or x, y and z of the body (d = 3) [mm].
    cells
        (E, A) int64, the points of each element, in the order of VTK.
    cell_type
        Name of the elements in meshio, one of `PARTS`.
    base
        (B,) int64, points of the base line from the root to the tip; none where there is no such line.
    clamp
        (C,) int64, points that are held fixed.
    """

    points_mm: Floats
    cells: Ints
    cell_type: str = "triangle"
    base: Ints = field(default_factory=lambda: NONE)
    clamp: Ints = field(default_factory=lambda: NONE)

    @cached_property
    def mesh(self) -> SimplexMesh:
        """The simplices between its points."""
        parts = PARTS[self.cell_type]
        simplices = np.ascontiguousarray(self.cells[:, parts]).reshape(-1, parts.shape[1])
        return SimplexMesh(self.points_mm, simplices)

    @property
    def axes(self) -> str:
        """Names of the coordinates: "xz" of a face, "xyz" of a body."""
        return AXES[self.points_mm.shape[1]]

    @property
    def is_body(self) -> bool:
        """Whether it is a body in space, not a face."""
        return self.points_mm.shape[1] == 3

    @property
    def tip_mm(self) -> Floats:
        """The end of the base line (d,) [mm]."""
        return self.points_mm[self.base[-1]]

    def locate(self, points_mm: Floats) -> tuple[Ints, Floats]:
        """See `SimplexMesh.locate`."""
        return self.mesh.locate(points_mm)

    def interpolate(self, nodal: NDArray[np.float64], points_mm: Floats) -> Floats:
        """Values (…, M, k) at points (M, d) [mm] of a field with values (…, N, k) at the nodes.

        Linear between neighbouring nodes, of hexahedra with 20 nodes between corners; a point off the domain counts as
        the nearest one of its outline.
        """
        corners, weights = self.locate(points_mm)
        return np.einsum("mc,...mck->...mk", weights, nodal[..., corners, :])

    def fits(self) -> bool:
        """Whether the arrays fit together."""
        nodes = len(self.points_mm)
        return (
            self.points_mm.dtype == np.float64
            and all(index.dtype == np.int64 for index in (self.cells, self.base, self.clamp))
            and self.points_mm.ndim == self.cells.ndim == 2
            and self.cell_type in PARTS
            and self.points_mm.shape[1] == PARTS[self.cell_type].shape[1] - 1
            and self.cells.shape[1] > PARTS[self.cell_type].max()
            and self.base.ndim == self.clamp.ndim == 1
            and all(_within(index, nodes) for index in (self.cells, self.base, self.clamp))
            and bool(np.isfinite(self.points_mm).all())
        )


def _within(index: Ints, nodes: int) -> bool:
    return index.size == 0 or bool(0 <= index.min() <= index.max() < nodes)
