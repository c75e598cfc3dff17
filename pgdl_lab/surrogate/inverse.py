"""The pressure for a place of the tip or for a curvature of the base line."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError

if TYPE_CHECKING:
    from pgdl_lab.core.domain import Domain
    from pgdl_lab.surrogate.probe import Probe

Floats = NDArray[np.float64]

SCANNED = 65  # pressures that are looked at once to find the brackets
ITERATIONS = 60  # more than bisection alone needs
EXACT = 1e-10  # of the trained range: steps below it end the search


@dataclass(frozen=True)
class Answer:
    """The pressure that comes nearest to a target.

    Attributes
    ----------
    kpa
        The pressure [kPa].
    reached
        Whether what is left is within the tolerance.
    distance
        What is left: distance of the tip [mm] or difference of the curvatures [1/m].
    unit
        Its unit.
    """

    kpa: float
    reached: bool
    distance: float
    unit: str

    def __float__(self) -> float:
        return self.kpa

    def __str__(self) -> str:
        if self.reached:
            return f"{self.kpa:.4g} kPa reaches the target within {self.distance:.2g} {self.unit}."
        return f"The target is out of reach: {self.kpa:.4g} kPa comes nearest, {self.distance:.3g} {self.unit} off."


class Quantity(ABC):
    """Something that the pressure moves, for example the place of the tip.

    Parameters
    ----------
    low_kpa, high_kpa
        Pressures between which it is sought [kPa].
    """

    unit: str
    tolerance: float

    def __init__(self, low_kpa: float, high_kpa: float) -> None:
        self.low_kpa, self.high_kpa = low_kpa, high_kpa

    @abstractmethod
    def state(self, kpa: float) -> tuple[Floats, Floats]:
        """Values (m,) and their derivatives (m,) by the pressure."""

    @cached_property
    def scan(self) -> tuple[Floats, Floats, Floats]:
        """Pressures (S,), values (S, m) and derivatives (S, m)."""
        pressures = np.linspace(self.low_kpa, self.high_kpa, SCANNED)
        values, slopes = zip(*(self.state(float(kpa)) for kpa in pressures), strict=True)
        return pressures, np.array(values), np.array(slopes)

    def nearest(self, target: Floats, tolerance: float) -> Answer:
        """The pressure at which the values are nearest to `target` (m,), of which NaN are free.

        The squared distance has a minimum where its derivative changes sign: brackets are found by looking at a few
        pressures, and a minimum in them by Gauss–Newton steps, or halves where these leave the bracket or are slow.
        """
        wanted = np.isfinite(target)
        target = target[wanted]
        pressures, values, slopes = self.scan
        downhill = ((values[:, wanted] - target) * slopes[:, wanted]).sum(axis=1) < 0
        found = [self.low_kpa] * (not downhill[0]) + [self.high_kpa] * bool(downhill[-1])
        for i in np.flatnonzero(downhill[:-1] & ~downhill[1:]):
            found.append(self._minimum(float(pressures[i]), float(pressures[i + 1]), wanted, target))
        distances = [float(np.linalg.norm(self.state(kpa)[0][wanted] - target)) for kpa in found]
        reached = sorted(kpa for kpa, distance in zip(found, distances, strict=True) if distance <= tolerance)
        best = found.index(reached[0]) if reached else int(np.argmin(distances))
        return Answer(found[best], bool(reached), distances[best], self.unit)

    def _minimum(self, low: float, high: float, wanted: NDArray[np.bool_], target: Floats) -> float:
        kpa, step = (low + high) / 2, high - low
        for _ in range(ITERATIONS):
            value, slope = (part[wanted] for part in self.state(kpa))
            force = float((value - target) @ slope)
            low, high = (kpa, high) if force < 0 else (low, kpa)
            stiffness = float(slope @ slope)
            new = kpa - force / stiffness if stiffness > 0 else low
            if not low <= new <= high or abs(new - kpa) > step / 2:
                new = (low + high) / 2
            kpa, step = new, abs(new - kpa)
            if step <= EXACT * (self.high_kpa - self.low_kpa):
                break
        return kpa


class Tip(Quantity):
    """Place of a point of the face or of the body [mm].

    Parameters
    ----------
    probe
        The surrogate there.
    point_mm
        (d,), the undeformed point [mm].
    """

    unit = "mm"
    tolerance = 0.1

    def __init__(self, probe: Probe, point_mm: Floats, low_kpa: float, high_kpa: float) -> None:
        super().__init__(low_kpa, high_kpa)
        self._probe, self._point_mm = probe, point_mm

    def state(self, kpa: float) -> tuple[Floats, Floats]:
        return self._point_mm + self._probe.value(kpa)[0], self._probe.slope(kpa)[0]


class Curvature(Quantity):
    """Mean curvature of the base line in the x–z plane [1/m].

    Parameters
    ----------
    probe
        The surrogate on the base line.
    line_mm
        (B, d), the undeformed base line [mm].
    """

    unit = "1/m"
    tolerance = 0.01

    def __init__(self, probe: Probe, line_mm: Floats, low_kpa: float, high_kpa: float) -> None:
        super().__init__(low_kpa, high_kpa)
        self._probe, self._line_mm = probe, line_mm

    def state(self, kpa: float) -> tuple[Floats, Floats]:
        from pgdl_lab.surrogate.curvature import mean_curvature_per_m

        bent, turned = self._line_mm + self._probe.value(kpa), self._probe.slope(kpa)
        line, along = bent[:, [0, -1]], turned[:, [0, -1]]  # x and z
        step = 1e-3 / max(float(np.abs(along).max()), 1e-9)  # moves the line by a micrometre
        ahead, behind = (mean_curvature_per_m(line + sign * step * along) for sign in (1, -1))
        return np.array([mean_curvature_per_m(line)]), np.array([(ahead - behind) / (2 * step)])


class Inverse:
    """What a surrogate can be asked backwards.

    Parameters
    ----------
    domain
        The side face or the body, with its base line.
    probe
        The surrogate at points (N, d) [mm].
    low_kpa, high_kpa
        Pressures between which it is sought [kPa].
    """

    def __init__(self, domain: Domain, probe: Callable[[Floats], Probe], low_kpa: float, high_kpa: float) -> None:
        points, base, self.axes = domain.points_mm, domain.base, domain.axes
        self.tip = Tip(probe(points[base[-1:]]), points[base[-1]], low_kpa, high_kpa)
        self.curvature = Curvature(probe(points[base]), points[base], low_kpa, high_kpa)

    def pressure_for(
        self, tip: Sequence[float | None] | None, curvature: float | None, tolerance: float | None
    ) -> Answer:
        """See `Surrogate.pressure_for`."""
        if (tip is None) == (curvature is None):
            tip_of = ", ".join(self.axes)
            raise InputError(f"pressure_for takes one target: tip=({tip_of}) in mm or curvature= in 1/m.")
        quantity = self.curvature if tip is None else self.tip
        if tolerance is None:
            tolerance = quantity.tolerance
        elif not tolerance >= 0:
            raise InputError(f"tolerance is {tolerance} {quantity.unit}; it must not be negative.")
        target = _target([curvature], 1, self.axes) if tip is None else _target(tip, len(self.axes), self.axes)
        return quantity.nearest(target, tolerance)


def _target(values: Sequence[float | None], count: int, axes: str) -> Floats:
    """The `count` numbers of a target, NaN for None; a tip has one along each of the `axes`."""
    try:
        numbers = np.array([np.nan if value is None else float(value) for value in values])
        free = np.array([value is None for value in values])
    except (TypeError, ValueError):
        numbers, free = np.empty(0), np.empty(0, dtype=bool)
    if len(numbers) != count or free.all() or not np.isfinite(numbers[~free]).all():
        tip = ", ".join(axes)
        raise InputError(f"The target {values} must be finite numbers: tip=({tip}) in mm, or curvature= in 1/m.")
    return numbers
