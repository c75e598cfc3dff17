"""The plugin kind `split`: which of the simulated points a surrogate is trained on."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases

ROUNDING = 1e-9  # pressures are sums and products of floats: 0.88 · 50 kPa must include the snapshot at 44 kPa

SELECTED = 2000  # points that a search selects by, at most: a training that it watches is not slowed down by them
SELECTION = 2  # beside the seed: a random stream that nothing else draws from


@dataclass(frozen=True)
class Split(ABC):
    """A rule that divides the points of all cases into training points, points to select by and test points.

    A point of the data is one node in one case, called a snapshot where the cases are pressures; point `i` is node
    `i % N` of case `i // N`.

    Attributes
    ----------
    points
        Number of training points.
    """

    points: int = 20_000

    def __post_init__(self) -> None:
        if self.points < 1:
            raise InputError(f"split.points is {self.points}; a surrogate needs at least 1 training point.")

    @abstractmethod
    def seen(self, cases: Cases) -> NDArray[np.bool_]:
        """Which of the cases may give training points: (C,) bool; those of a simulation are at rising pressures."""

    def highlights(self, cases: Cases) -> NDArray[np.int64]:
        """Indices of the cases that tables and figures show: at 20, 40 … 100 % of the highest pressure."""
        return nearest(cases.pressures_kpa, np.linspace(0.2, 1, 5) * cases.pressures_kpa[-1])

    def check(self, cases: Cases, nodes: int) -> None:
        """Refuse a split that cannot be made of these cases with `nodes` points each.

        Needs no displacements, so that it can be asked before a long simulation.

        Raises
        ------
        InputError
            When no case is in range, too many points are asked for, or no test point is left.
        """
        snapshots = len(self._seen(cases))
        available, total = snapshots * nodes, len(cases) * nodes
        if snapshots == 0:
            raise InputError(
                f"No snapshot lies in the training range: the lowest pressure is {cases.pressures_kpa.min():g} kPa; "
                "widen the split or raise observation.snapshots."
            )
        if self.points > available:
            raise InputError(
                f"split.points is {self.points}, but the {snapshots} training snapshots hold {available} points; "
                "ask for fewer or raise observation.points."
            )
        if self.points == total:
            raise InputError(
                f"split.points is {self.points}, which is every point and leaves none to test on; ask for fewer."
            )

    def _seen(self, cases: Cases) -> NDArray[np.int64]:
        """Indices of the cases that may give training points."""
        seen = np.asarray(self.seen(cases))
        if seen.dtype != bool or seen.shape != (len(cases),):
            raise InputError(
                f"{type(self).__name__}.seen gave {seen.dtype} of shape {seen.shape}; it must give bool of shape "
                f"({len(cases)},), one for each case."
            )
        return np.flatnonzero(seen)

    def train_points(self, data: Dataset, seed: int) -> NDArray[np.int64]:
        """Sorted indices (n,) of the training points, drawn evenly from the seen cases.

        Raises
        ------
        InputError
            See `check`.
        """
        nodes = len(data.domain.points_mm)
        self.check(data.cases, nodes)
        seen = self._seen(data.cases)
        drawn = np.random.default_rng(seed).choice(len(seen) * nodes, self.points, replace=False)
        return np.sort(seen[drawn // nodes] * nodes + drawn % nodes)

    def selection_points(self, data: Dataset, train: NDArray[np.int64], seed: int) -> NDArray[np.int64]:
        """Sorted indices (m,) of points that a search selects by: neither trained on nor tested on.

        They are a tenth of the points of the seen cases that are not trained on, at most `SELECTED`. Cases that give
        no training points are left to the test as a whole: who selects by them knows what they look like.

        Parameters
        ----------
        data, seed
            See `train_points`.
        train
            (n,), indices of the training points.
        """
        nodes = len(data.domain.points_mm)
        seen = self._seen(data.cases)
        others = np.setdiff1d((seen[:, None] * nodes + np.arange(nodes)).ravel(), train, assume_unique=True)
        count = min(SELECTED, len(others) // 10)
        return np.sort(np.random.default_rng([seed, SELECTION]).choice(others, count, replace=False))


def nearest(pressures_kpa: NDArray[np.float64], wanted_kpa: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices, each once and rising, of the pressures (P,) [kPa] that lie nearest to `wanted_kpa` (W,) [kPa]."""
    return np.unique(np.abs(pressures_kpa[:, None] - wanted_kpa).argmin(axis=0))
