"""Invariants of the isochoric strain and their derivatives with respect to the right Cauchy–Green tensor.

Tensors have six components in the order 11, 22, 33, 12, 23, 13, which is their first axis, before any other axes.
Formulas: G. A. Holzapfel, Nonlinear Solid Mechanics, 2000, sections 6.4 and 6.6, brought into symmetric form.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROWS, COLUMNS = np.array([0, 1, 2, 0, 1, 0]), np.array([0, 1, 2, 1, 2, 2])  # of the six components
PLACES = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])  # among the six of each component


@dataclass(frozen=True)
class Invariant:
    """An invariant of J^(−2/3) C and its derivatives.

    Attributes
    ----------
    value
        (…) [–].
    first
        (6, …) derivative with respect to C [–].
    second
        (6, 6, …) second derivative [–]; None if not asked for.
    """

    value: Array
    first: Array
    second: Array | None


def first_invariant(c: Array, *, second: bool) -> Invariant:
    """Ī₁ = J^(−2/3) tr C at `c` (6, …), with its second derivative if asked for."""
    inverse, determinant = inverse_and_determinant(c)
    shrink = determinant ** (-1 / 3)
    value = shrink * (c[0] + c[1] + c[2])
    first = -value / 3 * inverse
    first[:3] += shrink
    if not second:
        return Invariant(value, first, None)
    crossed = inverse[:, None] * (first / 3 + value / 18 * inverse)
    return Invariant(value, first, value / 3 * product(inverse) - crossed - crossed.swapaxes(0, 1))


def second_invariant(c: Array, *, second: bool) -> Invariant:
    """Ī₂ = J^(−4/3) ((tr C)² − tr C²)/2 = J^(2/3) tr C⁻¹ at `c` (6, …), with its second derivative if asked for."""
    inverse, determinant = inverse_and_determinant(c)
    shrink = determinant ** (-2 / 3)
    value = shrink * determinant * (inverse[0] + inverse[1] + inverse[2])
    first = -shrink * c - 2 / 3 * value * inverse
    first[:3] += shrink * (c[0] + c[1] + c[2])
    if not second:
        return Invariant(value, first, None)
    crossed = 2 / 3 * inverse[:, None] * (first + value / 3 * inverse)
    matrix = 2 / 3 * value * product(inverse) - crossed - crossed.swapaxes(0, 1)
    matrix[:3, :3] += shrink
    for i in range(6):
        matrix[i, i] -= shrink if i < 3 else shrink / 2
    return Invariant(value, first, matrix)


def inverse_and_determinant(c: Array) -> tuple[Array, Array]:
    """C⁻¹ (6, …) and det C (…) of `c` (6, …)."""
    cofactor = np.stack(
        [
            c[1] * c[2] - c[4] * c[4],
            c[0] * c[2] - c[5] * c[5],
            c[0] * c[1] - c[3] * c[3],
            c[4] * c[5] - c[2] * c[3],
            c[3] * c[5] - c[0] * c[4],
            c[3] * c[4] - c[1] * c[5],
        ]
    )
    determinant = c[0] * cofactor[0] + c[3] * cofactor[3] + c[5] * cofactor[5]
    return cofactor / determinant, determinant


def product(inverse: Array) -> Array:
    """(C⁻¹_IK C⁻¹_JL + C⁻¹_IL C⁻¹_JK) / 2 (6, 6, …): −∂C⁻¹_IJ/∂C_KL, of C⁻¹ (6, …)."""
    i, j = ROWS[:, None], COLUMNS[:, None]
    k, m = ROWS, COLUMNS
    straight, exchanged = inverse[PLACES[i, k]] * inverse[PLACES[j, m]], inverse[PLACES[i, m]] * inverse[PLACES[j, k]]
    return (straight + exchanged) / 2
