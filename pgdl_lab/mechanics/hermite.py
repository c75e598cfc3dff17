"""Hermite interpolation of vector-valued functions of one parameter, and extrapolation by the same formula."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def hermite(nodes: Sequence[float], values: Sequence[Array], slopes: Sequence[Array], at: float) -> Array:
    """Value at `at` of the polynomial of degree 2 m − 1 through m `values` and `slopes` at `nodes`.

    With the Lagrange polynomials l_j: Σ (1 − 2 l_j'(x_j) (x − x_j)) l_j² v_j + (x − x_j) l_j² s_j
    (J. Stoer, R. Bulirsch, Introduction to Numerical Analysis, section 2.1.5).
    """
    x = np.asarray(nodes)
    result = np.zeros_like(values[0])
    for j, (value, slope) in enumerate(zip(values, slopes, strict=True)):
        others = np.delete(x, j)
        square = np.prod((at - others) / (x[j] - others)) ** 2
        steepness = (1 / (x[j] - others)).sum()
        result += (1 - 2 * steepness * (at - x[j])) * square * value + (at - x[j]) * square * slope
    return result
