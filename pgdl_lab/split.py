"""The plugin kind `split`: which of the simulated points a surrogate is trained on."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.snapshots import Snapshots


@dataclass(frozen=True)
class Split(ABC):
    """A rule that divides the points of all snapshots into training and test points.

    A point of the data is one node of one snapshot; point `i` is node `i % N` of snapshot `i // N`.

    Attributes
    ----------
    points
        Number of training points.
    """

    points: int = 20_000

    @abstractmethod
    def seen(self, pressures_kpa: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which snapshots may give training points: (P,) bool for pressures (P,) [kPa]."""

    def train_points(self, snapshots: Snapshots, seed: int) -> NDArray[np.int64]:
        """Sorted indices (n,) of the training points; every other point is a test point."""
        raise NotImplementedError  # to be written in terms of `seen`
