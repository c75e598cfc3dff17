"""Biquadratic interpolation on the grid of a profile: corners, edge middles and centres of its rectangles."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.profile import Profile, Region

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]


def quadratic(place: Array) -> tuple[Array, Array]:
    """Lagrange polynomials of the nodes 0, ½, 1 and their derivatives (3, ...) at `place` (...) in [0, 1]."""
    t = place
    return (
        np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)]),
        np.stack([4 * t - 3, 4 - 8 * t, 4 * t - 1]),
    )


@dataclass(frozen=True)
class Lattice:
    """The grid of a profile with its edges halved: (2 nx + 1) × (2 nz + 1) places, z running fastest.

    Attributes
    ----------
    grid
        The profile; every rectangle is one element.
    """

    grid: Profile

    @cached_property
    def x(self) -> Array:
        """Halved grid lines along x (2 nx + 1,) [mm]."""
        return halved(self.grid.x)

    @cached_property
    def z(self) -> Array:
        """Halved grid lines along z (2 nz + 1,) [mm]."""
        return halved(self.grid.z)

    def places(self, i: NDArray[np.int64], k: NDArray[np.int64]) -> NDArray[np.int64]:
        """The nine places (E, 9) of the rectangles in columns `i` and rows `k` (E,); z runs fastest."""
        along, up = 2 * i[:, None] + np.arange(3), 2 * k[:, None] + np.arange(3)
        return (along[:, :, None] * len(self.z) + up[:, None, :]).reshape(len(i), 9)

    def nearest(self, x: Array, z: Array) -> NDArray[np.int64]:
        """Places (N,) of nodes with coordinates `x` and `z` (N,) [mm]."""
        i = np.searchsorted((self.x[1:] + self.x[:-1]) / 2, x)
        k = np.searchsorted((self.z[1:] + self.z[:-1]) / 2, z)
        return i * len(self.z) + k

    def interpolation(self, points: Array) -> "csr_matrix":
        """Matrix (N, places) from values at the places to values at `points` (N, 2) on the body [mm].

        A point on a grid line takes a neighbouring rectangle that is no gap.
        """
        from scipy.sparse import csr_matrix

        grid, (x, z) = self.grid, points.T
        i, k = np.zeros(len(points), dtype=np.int64), np.zeros(len(points), dtype=np.int64)
        tiny = 1e-9 * (grid.x[-1] - grid.x[0])
        for dx in (tiny, -tiny):
            for dz in (tiny, -tiny):
                column = np.clip(np.searchsorted(grid.x, x + dx) - 1, 0, len(grid.x) - 2)
                row = np.clip(np.searchsorted(grid.z, z + dz) - 1, 0, len(grid.z) - 2)
                covered = grid.regions[column, row] != Region.GAP
                i, k = np.where(covered, column, i), np.where(covered, row, k)
        along, _ = quadratic((x - grid.x[i]) / (grid.x[i + 1] - grid.x[i]))
        up, _ = quadratic((z - grid.z[k]) / (grid.z[k + 1] - grid.z[k]))
        weights = np.einsum("an,bn->nab", along, up).reshape(len(points), 9)
        rows = np.repeat(np.arange(len(points)), 9)
        shape = (len(points), len(self.x) * len(self.z))
        return csr_matrix((weights.ravel(), (rows, self.places(i, k).ravel())), shape=shape)


def halved(lines: Array) -> Array:
    """`lines` with their middles."""
    return np.interp(np.arange(2 * len(lines) - 1) / 2, np.arange(len(lines)), lines)
