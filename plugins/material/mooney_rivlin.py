"""The Mooney–Rivlin solid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.invariants import first_invariant, second_invariant
from pgdl_lab.mechanics.material import CalculixCard, Material
from pgdl_lab.mechanics.response import Isochoric


@register("material", "mooney_rivlin")
@dataclass(frozen=True)
class MooneyRivlin(Material):
    """Mooney–Rivlin solid, W_iso = c10 (Ī₁ − 3) + c01 (Ī₂ − 3).

    Source: R. S. Rivlin, Philosophical Transactions of the Royal Society A 241, 1948.

    Attributes
    ----------
    c10_mpa, c01_mpa
        The coefficients [MPa]; μ = 2 (c10 + c01).
    """

    c10_mpa: float = 0.09
    c01_mpa: float = 0.02

    @property
    def shear_modulus_mpa(self) -> float:
        return 2 * (self.c10_mpa + self.c01_mpa)

    def isochoric(self, c: NDArray[np.float64], *, tangent: bool) -> Isochoric:
        first, second = first_invariant(c, second=tangent), second_invariant(c, second=tangent)
        return Isochoric(
            energy=self.c10_mpa * (first.value - 3) + self.c01_mpa * (second.value - 3),
            stress=2 * (self.c10_mpa * first.first + self.c01_mpa * second.first),
            tangent=None
            if first.second is None or second.second is None
            else 4 * (self.c10_mpa * first.second + self.c01_mpa * second.second),
        )

    def calculix(self) -> CalculixCard:
        return CalculixCard("MOONEY-RIVLIN", [1e6 * self.c10_mpa, 1e6 * self.c01_mpa], 1)
