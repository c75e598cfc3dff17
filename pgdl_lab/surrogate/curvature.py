"""Curvature of a base line."""

import numpy as np
from numpy.typing import NDArray

DEGREE = 9  # follows a bent finger with its ten chambers, but not the scatter of single points
MM_PER_M = 1000.0


def mean_curvature_per_m(line_mm: NDArray[np.float64]) -> float:
    """Mean curvature of a base line, by the turning of its tangent.

    x and z are fitted by polynomials of degree 9 in the arc length s (least squares on a Chebyshev basis). The mean
    curvature is the turning of the fitted tangent from root to tip divided by the fitted length: exact for a circular
    arc of any angle, and 0 for a straight line, where fitted circles break down.

    Parameters
    ----------
    line_mm
        (B, 2), points of the deformed base line from root to tip [mm].

    Returns
    -------
    Mean curvature [1/m], positive when the finger bends upwards (from x towards z).
    """
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line_mm, axis=0), axis=1))])
    fitted = [np.polynomial.Chebyshev.fit(arc, component, min(DEGREE, len(arc) - 1)).deriv() for component in line_mm.T]
    s = np.linspace(0, arc[-1], 10 * DEGREE + 1)
    tangent_x, tangent_z = (derivative(s) for derivative in fitted)
    angle = np.unwrap(np.arctan2(tangent_z, tangent_x))
    length = np.trapezoid(np.hypot(tangent_x, tangent_z), s)
    return float((angle[-1] - angle[0]) / length * MM_PER_M)


def rms_distance_mm(line_mm: NDArray[np.float64], other_mm: NDArray[np.float64]) -> float:
    """Root mean square of the distance between the same material points (B, 2) of two base lines [mm]."""
    return float(np.sqrt(((line_mm - other_mm) ** 2).sum(axis=1).mean()))
