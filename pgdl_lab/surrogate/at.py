"""A surrogate at fixed points, for control loops."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.surrogate.outside import Watched
from pgdl_lab.surrogate.probe import Case, Probe
from pgdl_lab.surrogate.query import Asked, cases_of

Floats = NDArray[np.float64]


class At:
    """A surrogate at fixed points; see `Surrogate.at`.

    Parameters
    ----------
    surrogate
        The surrogate.
    points_mm
        (N, d), checked points [mm].
    probe
        The surrogate at them.
    beyond
        Whether any case is answered.
    """

    def __init__(self, surrogate: Watched, points_mm: Floats, probe: Probe, beyond: bool = False) -> None:
        self._surrogate, self._points_mm, self._probe, self._beyond = surrogate, points_mm, probe, beyond
        trained, allowed = surrogate.limits[0].trained, surrogate.limits[0].allowed
        self._one = len(surrogate.inputs) == 1
        largest = sys.float_info.max  # infinite pressures are named below
        self._low, self._high = max(trained.least, -largest), min(trained.most, largest)
        self._least, self._most = (-largest, largest) if beyond else (allowed.least, allowed.most)

    def __call__(self, pressure_kpa: Asked) -> Floats:
        """Displacement (N, d) [mm] at a pressure [kPa], or in a case of several inputs, see `Surrogate.predict`."""
        return self._probe.value(self._checked(pressure_kpa))

    def slope(self, pressure_kpa: Asked) -> Floats:
        """Derivative (N, d) of the displacement by the pressure [mm/kPa], or (N, d, D) by each of several inputs."""
        return self._probe.slope(self._checked(pressure_kpa))

    def _checked(self, asked: Asked) -> Case:
        if self._one:
            try:
                kpa: Any = asked
                if self._low <= kpa <= self._high:  # not so for NaN
                    return float(kpa)
                if self._least <= kpa <= self._most and self._surrogate.settled("inputs"):
                    return float(kpa)
            except (TypeError, ValueError):
                pass  # what is no number is named below
        cases, single = cases_of(asked, self._surrogate.inputs)
        if not single:
            name = self._surrogate.inputs[0]
            raise InputError(f"{name} has shape {cases.shape}; it must be one number in kPa, or use predict.")
        self._surrogate.check_cases(self._points_mm, cases, self._beyond)
        return float(cases[0]) if self._one else cases[0]
