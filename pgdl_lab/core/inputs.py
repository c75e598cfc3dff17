"""What a simulation is asked at: named inputs with a unit and a range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PRESSURE = "pressure_kpa"


@dataclass(frozen=True)
class Input:
    """One number that may differ from case to case.

    Attributes
    ----------
    name
        Name with the unit at its end, such as "pressure_kpa" or "tip_force_z_n".
    unit
        The unit as people write it.
    low, high
        The range of interest.
    """

    name: str
    unit: str
    low: float
    high: float


def pressure(high_kpa: float) -> tuple[Input, ...]:
    """The one input of a finger with one pressure, from none to `high_kpa` [kPa]."""
    return (Input(PRESSURE, "kPa", 0.0, float(high_kpa)),)


def names(inputs: Sequence[Input]) -> list[str]:
    """Their names."""
    return [each.name for each in inputs]


def column(inputs: Sequence[Input], cases: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Values (C,) of one input in cases (C, D).

    Raises
    ------
    KeyError
        When there is no such input.
    """
    known = names(inputs)
    if name not in known:
        raise KeyError(f"There is no input '{name}', only {', '.join(known)}.")
    return cases[:, known.index(name)]
