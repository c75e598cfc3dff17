"""What a surrogate says to questions that it was not trained for."""

from __future__ import annotations

import os
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import PRESSURE
from pgdl_lab.core.simplices import place
from pgdl_lab.surrogate.limits import Limits, Outside, TooFar
from pgdl_lab.surrogate.record import Record

Floats = NDArray[np.float64]

HERE = os.path.dirname(__file__)


class Watched(ABC):
    """A surrogate, as far as it knows what it was trained for; see `Surrogate`."""

    knows_body: bool = True

    def __init__(self, record: Record) -> None:
        self.record = record
        self.outside = "warn"
        self._warned: dict[str, object] = {}
        self.limits = Limits.of(record.ranges)
        self.inputs = [limit.name for limit in self.limits]

    @abstractmethod
    def bars(self, points_mm: Floats, cases: Floats) -> Floats | None:
        """Error bars (P, N) [mm] at checked points (N, 2) [mm] and cases, see `Probe.values`; None: has none."""

    def settled(self, what: str) -> bool:
        """Whether nothing more is to be said of "points" or "inputs" outside."""
        return self.outside == "ignore" or (self.outside == "warn" and what in self._warned)

    def check_points(self, points_mm: Floats) -> None:
        domain = self.record.domain
        if domain is None or self.settled("points") or not len(points_mm):
            return
        distance_mm = domain.mesh.distance_mm(points_mm, *domain.locate(points_mm))
        off = np.flatnonzero(distance_mm > domain.mesh.tolerance_mm)
        if len(off):
            self._complain(
                "points",
                lambda: (
                    f"{len(off)} of {len(points_mm)} points lie off the undeformed body, such as "
                    f"{place(points_mm[distance_mm.argmax()])} by {distance_mm.max():.3g} mm: give points in mm on the "
                    "body; each "
                    f"{'counts as the nearest point on it' if self.knows_body else 'is answered where it lies'}"
                    ", and no error bar tells how far off that is."
                ),
            )

    def check_cases(self, points_mm: Floats, cases: Floats, beyond: bool) -> None:
        """Refuse or warn of cases outside, see `predict`."""
        outside = [(limit, values) for limit, values in self._by_input(cases) if not limit.trained.holds(values)]
        if not outside:
            return
        if not beyond:
            self.check_distance(cases)
        if self.settled("inputs"):
            return
        limit, values = outside[0]

        def message() -> str:
            farthest = limit.trained.farthest(values)
            return (
                f"{limit.told(farthest)} lies outside the trained {self.trained_range(limit)}: give "
                f"{limit.values} within them, or take the answer as an extrapolation"
                f"{self._told_bar(points_mm, cases[values == farthest])}."
            )

        self._complain("inputs", message)

    def _by_input(self, cases: Floats) -> Iterator[tuple[Limits, Floats]]:
        return zip(self.limits, np.atleast_2d(cases.T), strict=True)

    def check_distance(self, cases: Floats) -> None:
        """Refuse cases outside those allowed."""
        for limit, values in self._by_input(cases):
            allowed = limit.allowed
            if not allowed.holds(values):
                raise TooFar(
                    f"{limit.told(allowed.farthest(values))} lies too far outside the trained "
                    f"{self.trained_range(limit)} for an answer to be worth anything: give {limit.values} from "
                    f"{allowed.low:g} to {allowed.high:g}, train on {'higher' if limit.name == PRESSURE else 'such'} "
                    "ones, or pass beyond=True for whatever comes out."
                )

    def trained_range(self, limit: Limits) -> str:
        low, high = self.record.ranges[limit.name]
        return f"{low:g} to {high:g}{' kPa' if limit.name == PRESSURE else ''}"

    def _told_bar(self, points_mm: Floats, cases: Floats) -> str:
        bars = self.bars(points_mm, cases[:1]) if len(points_mm) else None
        return " without an error bar" if bars is None else f", with an error bar of up to {bars.max():.2g} mm"

    def _complain(self, what: str, message: Callable[[], str]) -> None:
        if self.outside == "raise":
            raise InputError(message())
        own = object()
        if self._warned.setdefault(what, own) is own:  # true of one thread alone
            warnings.warn(message(), Outside, stacklevel=_outside_this_room())


def _outside_this_room() -> int:
    """The stack level, from the function that calls this one, of the line that asked a surrogate something."""
    level, frame = 1, sys._getframe(1)
    while os.path.dirname(frame.f_code.co_filename) == HERE and frame.f_back is not None:
        level, frame = level + 1, frame.f_back
    return level
