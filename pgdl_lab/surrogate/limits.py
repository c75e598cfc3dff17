"""The cases that a surrogate was trained on, and those that it answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import PRESSURE, unit_of

AT_REST = 0.1  # of the highest trained pressure: if the lowest lies below that, all from 0 kPa on count as trained
ROUNDING = 1e-6  # of the largest trained pressure in size: what a controller's sums may lie off the trained ones
BEYOND = 1.25  # times the highest trained pressure: as far as a surrogate answers; see docs/export.md
PLACES = ("x_mm", "y_mm", "z_mm")  # what a surrogate remembers ranges of beside its inputs

Floats = NDArray[np.float64]


class Outside(UserWarning):
    """A question that the surrogate was not trained for."""


class TooFar(InputError):
    """An input so far outside the trained ones that an answer would be worth nothing."""


@dataclass(frozen=True)
class Band:
    """Values of an input from `low` to `high`, or by `rounding` off them."""

    low: float
    high: float
    rounding: float

    @property
    def least(self) -> float:
        """The least value that counts as one of them."""
        return self.low - self.rounding

    @property
    def most(self) -> float:
        """The greatest."""
        return self.high + self.rounding

    def holds(self, values: Floats) -> bool:
        """Whether none of the values (…) lies outside."""
        return not ((values < self.least) | (values > self.most)).any()

    def farthest(self, values: Floats) -> float:
        """That of the values (…) which lies farthest outside."""
        which = np.atleast_1d(values)
        return float(which[np.maximum(self.low - which, which - self.high).argmax()])


@dataclass(frozen=True)
class Limits:
    """Values of one input that count as trained, and those that are answered."""

    name: str
    trained: Band
    allowed: Band

    @property
    def unit(self) -> str:
        """Its unit."""
        return unit_of(self.name)

    @property
    def values(self) -> str:
        """What is to be given."""
        return "pressures in kPa" if self.name == PRESSURE else "values"

    def told(self, value: float) -> str:
        """A value as people write it."""
        return f"{value:g} kPa" if self.name == PRESSURE else f"{self.name} = {value:g}"

    @classmethod
    def of(cls, ranges: Mapping[str, Sequence[float]]) -> list[Limits]:
        """Those of each input by its least and greatest training value; if no input is known, a pressure has none.

        What is answered goes beyond the trained values of an input by a quarter of their range. Of a pressure it goes
        up to `BEYOND` times the highest trained one, and as far below the trained ones, but not to suction where none
        was trained.
        """
        inputs = {name: bounds for name, bounds in ranges.items() if name not in PLACES}
        if not inputs:
            everything = Band(-np.inf, np.inf, 0.0)
            return [cls(PRESSURE, everything, everything)]
        return [cls._of(name, *bounds) for name, bounds in inputs.items()]

    @classmethod
    def _of(cls, name: str, low: float, high: float) -> Limits:
        if name != PRESSURE:
            rounding, more = ROUNDING * (high - low), (BEYOND - 1) * (high - low)
            return cls(name, Band(low, high, rounding), Band(low - more, high + more, rounding))
        low = 0.0 if 0 <= low <= AT_REST * high else low
        largest = max(abs(low), abs(high))
        rounding, more = ROUNDING * largest, (BEYOND - 1) * largest
        least = max(low - more, 0.0) if low >= 0 else low - more
        return cls(name, Band(low, high, rounding), Band(least, high + more, rounding))


def along(cases: Floats, ranges: Sequence[Sequence[float]]) -> Floats:
    """How far cases go along the first input (n,): errors grow with that, and outside what is known.

    It is the first input's own value; where another input lies outside its range by a share of that, it is at least as
    far above the highest value of the first.

    Parameters
    ----------
    cases
        (n,) of one input, (n, D) of several.
    ranges
        Least and greatest trained value of each input.
    """
    if cases.ndim == 1 or cases.shape[1] == 1:
        return cases.reshape(len(cases))
    first, highest = cases[:, 0], ranges[0][1]
    low, high = np.array(ranges[1:], dtype=np.float64).T
    outside = np.maximum(low - cases[:, 1:], cases[:, 1:] - high) / (high - low)
    farthest = outside.max(axis=1)
    return np.where(farthest > ROUNDING, np.maximum(first, highest * (1 + farthest)), first)
