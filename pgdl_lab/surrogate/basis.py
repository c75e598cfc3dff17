"""Functions of the inputs that fields are made of: products of Chebyshev polynomials, one in each input."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.surrogate.shapes import FLOATS, INDICES, Shapes

SHAPES: Shapes = {"range_kpa": (FLOATS, 2), "ranges": (FLOATS, "I", 2), "degrees": (INDICES, "D", "I")}
"""What of a `Basis` is in the state of a surrogate with D functions of I inputs."""
MOST_DEGREE = 100  # that a file can ask for


@dataclass(frozen=True)
class Basis:
    """K functions of D inputs: T_k₁(t₁) · … · T_k_D(t_D), with each input mapped from its range to −1 … 1.

    Attributes
    ----------
    ranges
        Least and greatest value of each input that are mapped to −1 and 1; beyond them the polynomials go on.
    degrees
        Of each function, its degree in each input.
    """

    ranges: tuple[tuple[float, float], ...]
    degrees: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, ranges: Sequence[Iterable[float]], degree: int) -> Basis:
        """All products of total degree at most `degree`, the lower degrees first; of one input, T_0 … T_degree."""
        return cls.within(ranges, [degree] * len(ranges), degree)

    @classmethod
    def within(cls, ranges: Sequence[Iterable[float]], most: Sequence[int], degree: int) -> Basis:
        """All products of total degree at most `degree`, and in each input of a degree at most that in `most`."""
        known = product(*(range(min(highest, degree) + 1) for highest in most))
        degrees = sorted((each for each in known if sum(each) <= degree), key=lambda each: (sum(each), each[::-1]))
        bounds = tuple((float(low), float(high)) for low, high in ranges)
        return cls(bounds, tuple(degrees))

    def state(self) -> dict[str, NDArray[Any]]:
        """What the state of a surrogate holds of it, by `SHAPES`; of the pressure alone its range."""
        if len(self.ranges) == 1:
            return {"range_kpa": np.array(self.ranges[0])}
        return {"ranges": np.array(self.ranges), "degrees": np.array(self.degrees, dtype=np.int64)}

    @classmethod
    def restored(cls, state: Mapping[str, NDArray[Any]], count: int) -> Basis:
        """That of `count` functions in the state of a surrogate.

        Raises
        ------
        ValueError
            When their degrees are not those of a basis.
        """
        if "range_kpa" in state:
            return cls.of([state["range_kpa"]], count - 1)
        degrees = state["degrees"]
        if len(degrees) != count or degrees.min() < 0 or degrees.max() > MOST_DEGREE:
            raise ValueError(f"degrees is {degrees.shape}, from {degrees.min()} to {degrees.max()}")
        return cls(tuple(map(tuple, state["ranges"].tolist())), tuple(map(tuple, degrees.tolist())))

    def terms(self, columns: Sequence[Any]) -> list[Any]:
        """The K functions of the inputs' values, D numbers or arrays of one shape, of NumPy or of PyTorch."""
        powers = [
            polynomials((2 * values - low - high) / (high - low), 1 + max(each[number] for each in self.degrees))
            for number, (values, (low, high)) in enumerate(zip(columns, self.ranges, strict=True))
        ]
        return [reduce(mul, (powers[number][k] for number, k in enumerate(each))) for each in self.degrees]

    def __call__(self, cases: NDArray[np.float64]) -> NDArray[np.float64]:
        """The functions (n, K) in cases (n, D), or (n,) of one input."""
        cases = np.asarray(cases, dtype=np.float64)
        columns = [cases] if cases.ndim == 1 else list(cases.T)
        return np.stack(self.terms(columns), axis=-1)


def polynomials(t: Any, count: int) -> list[Any]:
    """The first `count` Chebyshev polynomials at t, a number or an array of NumPy or PyTorch."""
    values = [0 * t + 1, t]
    while len(values) < count:
        values.append(2 * t * values[-1] - values[-2])
    return values[:count]
