"""What a hyperelastic law answers to a strain."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Isochoric:
    """What a law answers to a right Cauchy–Green tensor C = FᵀF, without the part of the pressure.

    Attributes
    ----------
    energy
        (…) energy density W [MPa].
    stress
        (6, …) second Piola–Kirchhoff stress 2 ∂W/∂C [MPa].
    tangent
        (6, 6, …) 4 ∂²W/∂C∂C [MPa]; None if not asked for.
    """

    energy: Array
    stress: Array
    tangent: Array | None
