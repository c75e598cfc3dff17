"""What a simulation is asked at: named inputs with a unit and a range, and cases of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

PRESSURE = "pressure_kpa"

Floats = NDArray[np.float64]


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


@dataclass(frozen=True, eq=False)
class Cases:
    """Some points in the space of D inputs.

    Attributes
    ----------
    inputs
        The D inputs. The first is what each simulation was led along, as a rule the pressure.
    values
        (n, D) float64, their values in each case.
    simulation
        (n,) int64, which simulation each case comes from.
    """

    inputs: tuple[Input, ...]
    values: Floats
    simulation: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @classmethod
    def path(cls, pressures_kpa: Floats) -> Cases:
        """Those of one simulation at pressures (n,) [kPa]."""
        values = np.asarray(pressures_kpa, dtype=np.float64)[:, None]
        return cls(pressure(float(values.max(initial=0.0))), values, np.zeros(len(values), dtype=np.int64))

    def __len__(self) -> int:
        return len(self.values)

    @property
    def names(self) -> list[str]:
        """Names of the inputs."""
        return [each.name for each in self.inputs]

    def column(self, name: str) -> Floats:
        """Values (n,) of one input.

        Raises
        ------
        KeyError
            When there is no such input.
        """
        if name not in self.names:
            raise KeyError(f"There is no input '{name}', only {', '.join(self.names)}.")
        return self.values[:, self.names.index(name)]

    @property
    def pressures_kpa(self) -> Floats:
        """The pressure (n,) in each case [kPa]."""
        return self.column(PRESSURE)

    @property
    def asked(self) -> Floats:
        """The values as a surrogate is asked for them: (n,) of one input, (n, D) of several."""
        return self.values[:, 0] if len(self.inputs) == 1 else self.values

    @property
    def simulations(self) -> list[NDArray[np.int64]]:
        """Indices of the cases of each simulation."""
        return [np.flatnonzero(self.simulation == number) for number in np.unique(self.simulation)]

    def at(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Cases:
        """Some of these, by their indices (m,) or a mask (n,)."""
        return Cases(self.inputs, self.values[which], self.simulation[which])

    def joined(self, others: Cases) -> Cases:
        """These and after them the `others`, of the same inputs."""
        parts = [np.concatenate([getattr(self, name), getattr(others, name)]) for name in ("values", "simulation")]
        return Cases(self.inputs, *parts)

    def ranges(self) -> dict[str, list[float]]:
        """Least and greatest value of each input by its name."""
        return {
            name: [float(values.min()), float(values.max())]
            for name, values in zip(self.names, self.values.T, strict=True)
        }

    def fits(self) -> bool:
        """Whether the arrays fit together."""
        return (
            self.values.dtype == np.float64
            and self.simulation.dtype == np.int64
            and self.values.shape == (len(self.simulation), len(self.inputs))
            and self.simulation.ndim == 1
            and bool(np.isfinite(self.values).all())
        )


def unit_of(name: str) -> str:
    """The unit at the end of the name of an input, as people write it."""
    known: Sequence[tuple[str, str]] = (("_kpa", "kPa"), ("_mpa", "MPa"), ("_mm", "mm"), ("_deg", "°"), ("_n", "N"))
    return next((unit for end, unit in known if name.endswith(end)), "")
