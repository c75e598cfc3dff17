"""Hyperelastic laws: what the solid asks of them, and those that know the first invariant alone.

Tensors have six components in the order 11, 22, 33, 12, 23, 13, which is their first axis, before any other axes.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.invariants import first_invariant
from pgdl_lab.mechanics.response import Isochoric
from pgdl_lab.mechanics.stability import STABLE_STRETCH, weakness

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CalculixCard:
    """How a law is written in an input deck of CalculiX.

    Attributes
    ----------
    form
        What follows `*HYPERELASTIC,`.
    constants
        All but those of the volumetric terms, stresses in Pa.
    volumetric_terms
        Number of terms (J − 1)^(2 i) / D_i, i = 1, 2, ….
    principal
        Whether it is a law in principal stretches.
    """

    form: str
    constants: list[float]
    volumetric_terms: int
    principal: bool = False


@dataclass(frozen=True)
class Material(ABC):
    """A nearly incompressible isotropic solid, W = W_iso(J^(−2/3) C) + K/2 (J − 1)².

    A law must be stable up to a stretch of 2: see `pgdl_lab.mechanics.stability`.

    Attributes
    ----------
    poisson
        Poisson's ratio ν at small strain [–]; sets the bulk modulus.
    """

    poisson: float = field(default=0.49, kw_only=True)

    def __post_init__(self) -> None:
        if not np.isfinite(np.hstack(list(vars(self).values()))).all():
            raise InputError(f"A coefficient of the material is not finite ({self._coefficients()}).")
        if not 0 <= self.poisson < 0.5:
            raise InputError(f"material.poisson is {self.poisson}; it must lie in [0, 0.5): use 0.499 for a rubber.")
        if not 0 < self.shear_modulus_mpa < np.inf:
            raise InputError(
                f"The shear modulus of the material is {self.shear_modulus_mpa:g} MPa ({self._coefficients()}); it "
                "must be above 0, else the solid has no stiffness."
            )
        weak = weakness(lambda c: self.isochoric(c, tangent=True))
        if weak:
            raise InputError(
                f"The material ({self._coefficients()}) {weak}; it must be stable up to {STABLE_STRETCH:g}: change its "
                "coefficients or choose another law."
            )

    def _coefficients(self) -> str:
        """The law's own fields, as they are typed."""
        own = {name: value for name, value in vars(self).items() if name != "poisson"}
        return ", ".join(f"{name}={value}" for name, value in own.items())

    @property
    @abstractmethod
    def shear_modulus_mpa(self) -> float:
        """Shear modulus μ at small strain [MPa]."""

    @property
    def lame_mpa(self) -> float:
        """First Lamé constant at small strain, λ = 2 μ ν / (1 − 2 ν) [MPa]."""
        return 2 * self.shear_modulus_mpa * self.poisson / (1 - 2 * self.poisson)

    @property
    def bulk_modulus_mpa(self) -> float:
        """Bulk modulus, K = λ + 2 μ / 3 [MPa]."""
        return self.lame_mpa + 2 * self.shear_modulus_mpa / 3

    @abstractmethod
    def isochoric(self, c: Array, *, tangent: bool) -> Isochoric:
        """Energy, stress and, if asked for, tangent of W_iso at the right Cauchy–Green tensor `c` (6, …) [–]."""

    def calculix(self) -> CalculixCard:
        """The law in CalculiX.

        Raises
        ------
        InputError
            When CalculiX does not have it.
        """
        raise InputError(f"CalculiX has no such material ({self._coefficients()}): choose fem=solid or another law.")


@dataclass(frozen=True)
class FirstInvariantMaterial(Material):
    """A law W_iso(Ī₁), Ī₁ = J^(−2/3) tr C, for which the solid has a shorter way than by `isochoric`."""

    @abstractmethod
    def energy(self, first_invariant: Array) -> Array:
        """Isochoric energy density W(Ī₁) [MPa] at `first_invariant` Ī₁ [–]."""

    @abstractmethod
    def derivatives(self, first_invariant: Array) -> tuple[Array, Array]:
        """dW/dĪ₁ and d²W/dĪ₁² [MPa] at `first_invariant` Ī₁ [–]."""

    def isochoric(self, c: Array, *, tangent: bool) -> Isochoric:
        invariant = first_invariant(c, second=tangent)
        w1, w2 = self.derivatives(invariant.value)
        return Isochoric(
            energy=self.energy(invariant.value),
            stress=2 * w1 * invariant.first,
            tangent=None
            if invariant.second is None
            else 4 * (w1 * invariant.second + w2 * invariant.first[:, None] * invariant.first),
        )


@register("material", "yeoh")  # here and not in `plugins/`, as every finger is made of it unless told otherwise
@dataclass(frozen=True)
class Yeoh(FirstInvariantMaterial):
    """Yeoh solid, W_iso = c1 (Ī₁ − 3) + c2 (Ī₁ − 3)² + c3 (Ī₁ − 3)³; with c2 = c3 = 0 the neo-Hooke solid.

    Source: O. H. Yeoh, Rubber Chemistry and Technology 66, 1993.

    Attributes
    ----------
    c1_mpa, c2_mpa, c3_mpa
        The coefficients [MPa]; c2 and c3 may be negative as far as the solid stays stable. μ = 2 c1.
    """

    c1_mpa: float = 0.11
    c2_mpa: float = 0.02
    c3_mpa: float = 0.0

    @property
    def shear_modulus_mpa(self) -> float:
        return 2 * self.c1_mpa

    def energy(self, first_invariant: Array) -> Array:
        excess = first_invariant - 3
        return excess * (self.c1_mpa + excess * (self.c2_mpa + excess * self.c3_mpa))

    def derivatives(self, first_invariant: Array) -> tuple[Array, Array]:
        excess = first_invariant - 3
        first = self.c1_mpa + excess * (2 * self.c2_mpa + 3 * excess * self.c3_mpa)
        return first, 2 * self.c2_mpa + 6 * self.c3_mpa * excess

    def calculix(self) -> CalculixCard:
        return CalculixCard("YEOH", [1e6 * self.c1_mpa, 1e6 * self.c2_mpa, 1e6 * self.c3_mpa], 3)
