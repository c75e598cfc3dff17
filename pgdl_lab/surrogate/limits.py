"""The pressures that a surrogate was trained on, and those that it answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError

AT_REST = 0.1  # of the highest trained pressure: if the lowest lies below that, all from 0 kPa on count as trained
ROUNDING = 1e-6  # of the largest trained pressure in size: what a controller's sums may lie off the trained ones
BEYOND = 1.25  # times the highest trained pressure: as far as a surrogate answers; see docs/export.md

Floats = NDArray[np.float64]


class Outside(UserWarning):
    """A question that the surrogate was not trained for."""


class TooFar(InputError):
    """A pressure so far outside the trained ones that an answer would be worth nothing."""


@dataclass(frozen=True)
class Band:
    """Pressures from `low` to `high`, or by `rounding` off them [kPa]."""

    low: float
    high: float
    rounding: float

    @property
    def least(self) -> float:
        """The least pressure that counts as one of them [kPa]."""
        return self.low - self.rounding

    @property
    def most(self) -> float:
        """The greatest [kPa]."""
        return self.high + self.rounding

    def holds(self, pressures_kpa: Floats) -> bool:
        """Whether none of the pressures (…) [kPa] lies outside."""
        return not ((pressures_kpa < self.least) | (pressures_kpa > self.most)).any()

    def farthest(self, pressures_kpa: Floats) -> float:
        """That of the pressures (…) which lies farthest outside [kPa]."""
        which = np.atleast_1d(pressures_kpa)
        return float(which[np.maximum(self.low - which, which - self.high).argmax()])


@dataclass(frozen=True)
class Limits:
    """Pressures that count as trained, and those that are answered."""

    trained: Band
    allowed: Band

    @classmethod
    def of(cls, ranges: Mapping[str, Sequence[float]]) -> Limits:
        """From the least and greatest training value of "pressure_kpa"; if they are not known, there are none.

        What is answered goes up to `BEYOND` times the highest trained pressure, and as far below the trained ones, but
        not to suction where none was trained.
        """
        if "pressure_kpa" not in ranges:
            everything = Band(-np.inf, np.inf, 0.0)
            return cls(everything, everything)
        low, high = ranges["pressure_kpa"]
        low = 0.0 if 0 <= low <= AT_REST * high else low
        largest = max(abs(low), abs(high))
        rounding, more = ROUNDING * largest, (BEYOND - 1) * largest
        least = max(low - more, 0.0) if low >= 0 else low - more
        return cls(Band(low, high, rounding), Band(least, high + more, rounding))
