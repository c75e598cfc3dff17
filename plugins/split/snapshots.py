"""Split `snapshots`: whole pressures held out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.registry import register
from pgdl_lab.split import Split, nearest


@register("split", "snapshots")
@dataclass(frozen=True)
class WholeSnapshots(Split):
    """Points drawn at random from a few snapshots; every other pressure is held out.

    The training snapshots lie nearest to the Chebyshev points of the pressure range, end points included, which
    cluster at both ends and keep polynomial interpolation between them from oscillating.

    Attributes
    ----------
    train_snapshots
        Number of snapshots that give training points.
    """

    train_snapshots: int = 9

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.train_snapshots < 2:
            raise InputError(f"split.train_snapshots is {self.train_snapshots}; at least 2 are needed to interpolate.")

    def seen(self, pressures_kpa: NDArray[np.float64]) -> NDArray[np.bool_]:
        if self.train_snapshots >= len(pressures_kpa):
            raise InputError(
                f"split.train_snapshots is {self.train_snapshots} of {len(pressures_kpa)} snapshots, which holds none "
                "out; ask for fewer or raise observation.snapshots."
            )
        low, high = pressures_kpa[0], pressures_kpa[-1]
        chebyshev = (1 - np.cos(np.linspace(0, np.pi, self.train_snapshots))) / 2
        seen = np.zeros(len(pressures_kpa), dtype=bool)
        seen[nearest(pressures_kpa, low + (high - low) * chebyshev)] = True
        return seen
