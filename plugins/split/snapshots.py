"""Split `snapshots`: whole pressures held out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import register
from pgdl_lab.core.split import Split


@register("split", "snapshots")
@dataclass(frozen=True)
class SnapshotsSplit(Split):
    """Points drawn at random from a few snapshots; every other pressure is held out.

    The training snapshots lie as near as possible, in sum, to the Chebyshev points of the pressure range, end points
    included, which cluster at both ends and keep polynomial interpolation between them from oscillating.

    Attributes
    ----------
    train_snapshots
        Number of snapshots, of each simulation if there are several, that give training points.
    """

    train_snapshots: int = 9

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.train_snapshots < 2:
            raise InputError(f"split.train_snapshots is {self.train_snapshots}; at least 2 are needed to interpolate.")

    def seen(self, cases: Cases) -> NDArray[np.bool_]:
        seen = np.zeros(len(cases), dtype=bool)
        for part in cases.simulations:
            seen[part] = self._chosen(cases.pressures_kpa[part])
        return seen

    def _chosen(self, pressures_kpa: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the rising pressures (P,) [kPa] of one simulation."""
        if self.train_snapshots >= len(pressures_kpa):
            raise InputError(
                f"split.train_snapshots is {self.train_snapshots} of {len(pressures_kpa)} snapshots, which holds none "
                "out; ask for fewer or raise observation.snapshots."
            )
        from scipy.optimize import linear_sum_assignment

        low, high = pressures_kpa[0], pressures_kpa[-1]
        chebyshev = (1 - np.cos(np.linspace(0, np.pi, self.train_snapshots))) / 2
        # each point gets a snapshot of its own: near the ends several may be nearest to the same
        distance_kpa = np.abs(pressures_kpa[:, None] - (low + (high - low) * chebyshev))
        chosen = np.zeros(len(pressures_kpa), dtype=bool)
        chosen[linear_sum_assignment(distance_kpa)[0]] = True
        return chosen
