"""The x–z section of an extruded finger: a grid of rectangles, each solid, cavity or gap."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Region(IntEnum):
    """What a rectangle of a profile is made of."""

    GAP = 0
    SOLID = 1
    CAVITY = 2


def subdivide(lines: NDArray[np.float64], edge_mm: float) -> NDArray[np.float64]:
    """Grid lines between and including `lines` [mm], evenly spaced in each interval, at most `edge_mm` apart."""
    pieces = [
        np.linspace(start, stop, int(np.ceil((stop - start) / edge_mm - 1e-9)), endpoint=False)
        for start, stop in zip(lines[:-1], lines[1:], strict=True)
    ]
    return np.concatenate([*pieces, lines[-1:]])


@dataclass(frozen=True)
class Profile:
    """A section through the cavities of a finger.

    Attributes
    ----------
    x, z
        (nx + 1,) and (nz + 1,) rising grid lines [mm].
    regions
        (nx, nz) of `Region`: what lies between the lines.
    """

    x: NDArray[np.float64]
    z: NDArray[np.float64]
    regions: NDArray[np.int8]

    @classmethod
    def from_columns(cls, z: Sequence[float], columns: Sequence[tuple[float, Sequence[Region]]]) -> "Profile":
        """Put columns side by side, from the clamp to the tip.

        Parameters
        ----------
        z
            (nz + 1,) rising grid lines [mm].
        columns
            Length along x [mm] and the nz regions from the bottom up; columns of no length are left out.
        """
        lengths, regions = zip(*(column for column in columns if column[0] > 0), strict=True)
        return cls(np.cumsum([0.0, *lengths]), np.array(z, dtype=np.float64), np.array(regions, dtype=np.int8))

    def region(self, x: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.int8]:
        """Regions at points with coordinates `x` and `z` [mm]; outside the grid there is a gap."""
        i, k = np.searchsorted(self.x, x) - 1, np.searchsorted(self.z, z) - 1
        padded = np.pad(self.regions, 1, constant_values=Region.GAP)
        return padded[i + 1, k + 1]

    def refined(self, edge_mm: float) -> "Profile":
        """The same section on a grid whose edges are at most `edge_mm` [mm]."""
        x, z = subdivide(self.x, edge_mm), subdivide(self.z, edge_mm)
        i = np.searchsorted(self.x, (x[1:] + x[:-1]) / 2) - 1
        k = np.searchsorted(self.z, (z[1:] + z[:-1]) / 2) - 1
        return Profile(x, z, self.regions[np.ix_(i, k)])
