"""Split `extrapolate`: training below a cut-off pressure, tests above it (the paper's second approach)."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import PRESSURE, Cases
from pgdl_lab.core.registry import register
from pgdl_lab.core.split import ROUNDING, Split, nearest


@register("split", "extrapolate")
@dataclass(frozen=True)
class ExtrapolateSplit(Split):
    """Points drawn at random from the cases up to a cut-off pressure (paper, section IV-A, second approach).

    Attributes
    ----------
    train_fraction
        Cut-off as a fraction of the highest pressure: 0.88 of 50 kPa are the paper's 44 kPa.
    tested
        Fractions of the highest pressure that tables and figures show: the paper's 45, 47 and 50 kPa.
    input
        The input that is cut off; of another one than the pressure the fraction is that of its way from the least
        value to the greatest.
    """

    train_fraction: float = 0.88
    tested: list[float] = field(default_factory=lambda: [0.90, 0.94, 1.0])
    input: str = PRESSURE

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.train_fraction < 1:
            raise InputError(
                f"split.train_fraction is {self.train_fraction}; it must lie between 0 and 1, to leave some to test on."
            )
        if not self.tested or not all(self.train_fraction < fraction <= 1 for fraction in self.tested):
            raise InputError(
                f"split.tested is {list(self.tested)}; give fractions above train_fraction ({self.train_fraction}), "
                "up to 1."
            )

    def seen(self, cases: Cases) -> NDArray[np.bool_]:
        if self.input not in cases.names:
            raise InputError(f"split.input is '{self.input}'; the inputs of these data are {', '.join(cases.names)}.")
        values = cases.column(self.input)
        low = 0.0 if self.input == PRESSURE else values.min()
        return values - low <= self.train_fraction * (values.max() - low) * (1 + ROUNDING)

    def highlights(self, cases: Cases) -> NDArray[np.int64]:
        """Indices of the cases nearest to the tested fractions of the highest pressure."""
        return nearest(cases.pressures_kpa, np.array(self.tested) * cases.pressures_kpa[-1])
