"""Plane stress: a law whose thickness across the x–z plane follows from a stress that vanishes across it."""

from dataclasses import dataclass

import numpy as np

from pgdl_lab.mechanics.invariants import inverse_and_determinant, product
from pgdl_lab.mechanics.material import Array, Material
from pgdl_lab.mechanics.response import Isochoric
from pgdl_lab.mechanics.solid import InvertedElement

ACROSS = 1  # the component 22 of a tensor, along y
MOST_ITERATIONS = 30
SMALLEST_STEP = 1e-12  # of the squared stretch across


@dataclass(frozen=True)
class PlaneStress(Material):
    """A nearly incompressible solid with no stress along y; the whole of its energy, so that no pressure is left.

    The stretch along y is found by Newton's method at each point, and its tangent condensed, as for a plate (R. de
    Borst, International Journal for Numerical Methods in Engineering 32, 1991).

    Attributes
    ----------
    solid
        The law in three dimensions.
    """

    solid: Material

    def __post_init__(self) -> None:
        """The law in three dimensions has been checked."""

    @property
    def shear_modulus_mpa(self) -> float:
        return self.solid.shear_modulus_mpa

    @property
    def bulk_modulus_mpa(self) -> float:
        """None beside the law itself [MPa]."""
        return 0.0

    def isochoric(self, c: Array, *, tangent: bool) -> Isochoric:
        """As the base class says, of the whole energy; the component 22 of `c` is not looked at.

        Raises
        ------
        InvertedElement
            When no stretch across the plane is found.
        """
        c = c.copy()
        c[ACROSS] = 1 / (c[0] * c[2] - c[5] ** 2)  # of constant volume
        for _ in range(MOST_ITERATIONS):
            answer, derivative = self._whole(c)
            step = -2 * answer.stress[ACROSS] / derivative[ACROSS, ACROSS]
            step = np.clip(step, -c[ACROSS] / 2, c[ACROSS])
            c[ACROSS] += step
            if not np.isfinite(step).all():
                break
            if (np.abs(step) < SMALLEST_STEP * c[ACROSS]).all():
                return self._condensed(c, tangent)
        raise InvertedElement

    def _condensed(self, c: Array, tangent: bool) -> Isochoric:
        """Energy, stress and tangent in the plane at `c` (6, …) without stress across it."""
        answer, derivative = self._whole(c)
        answer.stress[ACROSS] = 0
        if not tangent:
            return Isochoric(answer.energy, answer.stress, None)
        across = derivative[ACROSS]
        return Isochoric(
            answer.energy, answer.stress, derivative - derivative[:, ACROSS, None] * across / across[ACROSS]
        )

    def _whole(self, c: Array) -> tuple[Isochoric, Array]:
        """The law with its volumetric part K/2 (J − 1)² at `c` (6, …), and its tangent."""
        modulus, answer = self.solid.bulk_modulus_mpa, self.solid.isochoric(c, tangent=True)
        inverse, square = inverse_and_determinant(c)
        j = np.sqrt(square)
        assert answer.tangent is not None
        tangent = answer.tangent + modulus * j * (
            (2 * j - 1) * inverse[:, None] * inverse - 2 * (j - 1) * product(inverse)
        )
        stress = answer.stress + modulus * j * (j - 1) * inverse
        return Isochoric(answer.energy + modulus / 2 * (j - 1) ** 2, stress, None), tangent
