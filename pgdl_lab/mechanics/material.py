"""Hyperelastic laws."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError


@dataclass(frozen=True)
class Yeoh:
    """Nearly incompressible Yeoh solid; with c2 = c3 = 0 the neo-Hooke solid.

    W = c1 (Ī₁ − 3) + c2 (Ī₁ − 3)² + c3 (Ī₁ − 3)³ + K/2 (J − 1)², Ī₁ = J^(−2/3) tr FᵀF
    (O. H. Yeoh, Rubber Chemistry and Technology 66, 1993, with the volumetric term of a nearly incompressible solid).

    Attributes
    ----------
    c1_mpa, c2_mpa, c3_mpa
        The coefficients [MPa].
    poisson
        Poisson's ratio ν at small strain [–]; sets the bulk modulus.
    """

    c1_mpa: float = 0.11
    c2_mpa: float = 0.02
    c3_mpa: float = 0.0
    poisson: float = 0.49

    def __post_init__(self) -> None:
        if self.c1_mpa <= 0:
            raise InputError(
                f"material.c1_mpa is {self.c1_mpa} MPa; it must be above 0, else the solid has no stiffness."
            )
        for name in ("c2_mpa", "c3_mpa"):
            if getattr(self, name) < 0:
                raise InputError(
                    f"material.{name} is {getattr(self, name)} MPa; it must not be negative, else the solid softens."
                )
        if not 0 <= self.poisson < 0.5:
            raise InputError(f"material.poisson is {self.poisson}; it must lie in [0, 0.5): use 0.499 for a rubber.")

    @property
    def shear_modulus_mpa(self) -> float:
        """Shear modulus at small strain, μ = 2 c1 [MPa]."""
        return 2 * self.c1_mpa

    @property
    def lame_mpa(self) -> float:
        """First Lamé constant at small strain, λ = 2 μ ν / (1 − 2 ν) [MPa]."""
        return 2 * self.shear_modulus_mpa * self.poisson / (1 - 2 * self.poisson)

    @property
    def bulk_modulus_mpa(self) -> float:
        """Bulk modulus, K = λ + 2 μ / 3 [MPa]."""
        return self.lame_mpa + 2 * self.shear_modulus_mpa / 3

    def energy(self, first_invariant: NDArray[np.float64]) -> NDArray[np.float64]:
        """Isochoric energy density W(Ī₁) [MPa] at `first_invariant` Ī₁ [–]."""
        excess = first_invariant - 3
        return excess * (self.c1_mpa + excess * (self.c2_mpa + excess * self.c3_mpa))

    def derivatives(self, first_invariant: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """dW/dĪ₁ and d²W/dĪ₁² [MPa] at `first_invariant` Ī₁ [–]."""
        excess = first_invariant - 3
        first = self.c1_mpa + excess * (2 * self.c2_mpa + 3 * excess * self.c3_mpa)
        return first, 2 * self.c2_mpa + 6 * self.c3_mpa * excess
