"""The x–z section of an extruded finger: a grid of rectangles, each solid, cavity or gap; and how it is cut finer.

Each interval between two grid lines is cut into the fewest equal parts that are no longer than the edge asked for.
`LEEWAY` keeps dimensions that are multiples of the edge, as round ones often are, away from the jump to one part more.
Where the edge is shorter than the intervals are on average, they are first cut for an edge that is not, twice or four
times … as long, and then halved: so half the edge gives the same mesh with each element halved in all directions.
"""

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


LEEWAY = 1.07  # of the edge: how long a part may be


def subdivide(lines: NDArray[np.float64], edge_mm: float, halvings: int = 0) -> NDArray[np.float64]:
    """Grid lines between and including `lines` [mm]; parts are at most `LEEWAY` times `edge_mm` long.

    They are cut for an edge of 2^`halvings` times `edge_mm` and then halved so often.
    """
    longest = LEEWAY * edge_mm * 2**halvings
    pieces = [
        np.linspace(start, stop, 2**halvings * int(np.ceil((stop - start) / longest - 1e-9)), endpoint=False)
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

    def halvings(self, edge_mm: float) -> int:
        """How often an interval of mean length is halved until its parts are no longer than `edge_mm` [mm]."""
        intervals = np.concatenate([np.diff(self.x), np.diff(self.z)])
        mean = float(np.exp(np.log(intervals).mean()))  # geometric: thin and long ones count alike
        return max(0, int(np.ceil(np.log2(mean / (LEEWAY * edge_mm)))))

    def refined(self, edge_mm: float, halvings: int | None = None) -> "Profile":
        """The same section on a finer grid, cut by `subdivide`; `halvings`: those of the mean interval by default."""
        halvings = self.halvings(edge_mm) if halvings is None else halvings
        x, z = subdivide(self.x, edge_mm, halvings), subdivide(self.z, edge_mm, halvings)
        i = np.searchsorted(self.x, (x[1:] + x[:-1]) / 2) - 1
        k = np.searchsorted(self.z, (z[1:] + z[:-1]) / 2) - 1
        return Profile(x, z, self.regions[np.ix_(i, k)])
