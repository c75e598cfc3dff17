"""The Ogden solid."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.invariants import COLUMNS, PLACES, ROWS
from pgdl_lab.mechanics.material import CalculixCard, Material
from pgdl_lab.mechanics.response import Isochoric

Array = NDArray[np.float64]

CALCULIX_TERMS = 3  # the most that it takes
FIRST, SECOND = ROWS[3:], COLUMNS[3:]  # the pairs of principal directions


@register("material", "ogden")
@dataclass(frozen=True)
class Ogden(Material):
    """Ogden solid of any number of terms, W_iso = Σ μ_i/α_i (λ̄₁^α_i + λ̄₂^α_i + λ̄₃^α_i − 3), λ̄ = J^(−1/3) λ.

    Source: R. W. Ogden, Proceedings of the Royal Society A 326, 1972. Coefficients that go with 2 μ_i/α_i² in the place
    of μ_i/α_i, as in Abaqus, are multiplied by 2/α_i before they are typed here.

    Attributes
    ----------
    mu_mpa
        The moduli μ_i [MPa]; μ = Σ μ_i α_i / 2.
    alpha
        The exponents α_i, as many [–].
    """

    mu_mpa: list[float] = field(default_factory=lambda: [0.22, 0.044])
    alpha: list[float] = field(default_factory=lambda: [1.0, 5.0])

    def __post_init__(self) -> None:
        if len(self.mu_mpa) != len(self.alpha) or not self.alpha:
            raise InputError(
                f"material.mu_mpa has {len(self.mu_mpa)} values and material.alpha {len(self.alpha)}: give as many, "
                "and at least one each."
            )
        if 0 in self.alpha:
            raise InputError(f"material.alpha is {list(self.alpha)}; an exponent must not be 0.")
        super().__post_init__()

    @property
    def shear_modulus_mpa(self) -> float:
        return sum(mu * alpha for mu, alpha in zip(self.mu_mpa, self.alpha, strict=True)) / 2

    def isochoric(self, c: Array, *, tangent: bool) -> Isochoric:
        values, axes = np.linalg.eigh(np.moveaxis(c[PLACES], (0, 1), (-2, -1)))
        squares = np.moveaxis(values, -1, 0)  # of the principal stretches (3, …)
        shrink = np.prod(squares, axis=0) ** (-1 / 3)
        mu, power = np.array(self.mu_mpa), np.array(self.alpha) / 2
        unit = shrink * squares  # λ̄²
        logarithms = np.multiply.outer(power, np.log(unit))  # (I, 3, …)
        terms = np.exp(logarithms)  # λ̄^α
        slopes = np.tensordot(mu, terms, axes=1)  # λ̄ ∂W/∂λ̄ before the mean is taken off
        mean = slopes.mean(axis=0)
        kirchhoff = slopes - mean
        principal = kirchhoff / squares
        # Products of the axes: n_a ⊗ n_a, then n_a ⊗ n_b + n_b ⊗ n_a; (…, 6, 6) with the six components first.
        own = axes[..., ROWS, :] * axes[..., COLUMNS, :]
        energy = np.tensordot(mu / (2 * power), np.expm1(logarithms).sum(axis=1), axes=1)
        stress = np.einsum("...ia,a...->i...", own, principal)
        if not tangent:
            return Isochoric(energy, stress, None)

        growth = np.tensordot(mu * power, terms, axes=1)
        stretching = growth.mean(axis=0) / 3 - (growth[:, None] + growth) / 3
        for a in range(3):
            stretching[a, a] += growth[a] - kirchhoff[a]
        stretching *= 2 / (squares[:, None] * squares)
        # The shear modulus of two axes is the divided difference of their stresses in λ². Of x^q that is
        # (x y)^((q − 1)/2) sinh(q r)/sinh(r) with r = ln(x/y)/2, as exact for stretches that are close or the same.
        product, ratio = unit[FIRST] * unit[SECOND], np.log(unit[FIRST] / unit[SECOND]) / 2
        shearing = mean / product
        for m, p in zip(mu, power, strict=True):
            shearing += m * product ** ((p - 2) / 2) * _ratio_of_sines(p - 1, ratio)
        shearing *= shrink**2
        mixed = axes[..., ROWS, :][..., FIRST] * axes[..., COLUMNS, :][..., SECOND]
        mixed += axes[..., ROWS, :][..., SECOND] * axes[..., COLUMNS, :][..., FIRST]
        full = own @ np.moveaxis(stretching, (0, 1), (-2, -1)) @ own.swapaxes(-1, -2)
        full += (mixed * np.moveaxis(shearing, 0, -1)[..., None, :]) @ mixed.swapaxes(-1, -2)
        return Isochoric(energy, stress, np.moveaxis(full, (-2, -1), (0, 1)))

    def calculix(self) -> CalculixCard:
        terms = len(self.alpha)
        if terms > CALCULIX_TERMS:
            raise InputError(
                f"CalculiX takes {CALCULIX_TERMS} terms of Ogden's at most, not {terms}: choose fem=solid."
            )
        # CalculiX has 2 μ_i/α_i² in the place of μ_i/α_i.
        pairs = [(1e6 * mu * alpha / 2, float(alpha)) for mu, alpha in zip(self.mu_mpa, self.alpha, strict=True)]
        return CalculixCard(f"OGDEN,N={terms}", [value for pair in pairs for value in pair], terms, principal=True)


def _ratio_of_sines(factor: float, r: Array) -> Array:
    """sinh(q r) / sinh(r) of a `factor` q; q where r = 0."""
    sines = np.sinh(r)
    return np.divide(np.sinh(factor * r), sines, out=np.full_like(r, factor), where=sines != 0)
