"""A surrogate at fixed points: all that does not depend on the pressure is done once."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.surrogate.basis import polynomials

Floats = NDArray[np.float64]

STEP = 1e-4  # of a central difference, by the pressure or 1 kPa: error of truncation and of rounding are alike


class Probe(ABC):
    """The displacement of N fixed points as a function of the pressure alone."""

    @abstractmethod
    def value(self, kpa: float) -> Floats:
        """Displacement (N, d) [mm] at a pressure [kPa]."""

    def slope(self, kpa: float) -> Floats:
        """Derivative (N, d) of the displacement by the pressure [mm/kPa]; here a central difference."""
        step = STEP * max(abs(kpa), 1.0)
        return (self.value(kpa + step) - self.value(kpa - step)) / (2 * step)

    def values(self, pressures_kpa: Floats) -> Floats:
        """Displacements (P, N, d) [mm] at pressures (P,) [kPa]."""
        shape = (len(pressures_kpa), *self.value(0.0).shape)
        return np.array([self.value(float(kpa)) for kpa in pressures_kpa]).reshape(shape)


class PolynomialProbe(Probe):
    """Displacements that are a sum of modes whose amplitudes are polynomials in the pressure.

    The sums are taken by NumPy's own loops, in one order whatever the processor, so that they are the same to the last
    bit on every machine; a matrix product, whose order is the library's, would take two thirds of the time.

    Parameters
    ----------
    modes
        (K, N, d).
    amplitudes_mm
        (D, K), coefficients of Chebyshev polynomials [mm].
    range_kpa
        (2,), pressures that are mapped to −1 … 1 [kPa].
    """

    def __init__(self, modes: Floats, amplitudes_mm: Floats, range_kpa: Floats) -> None:
        low, high = (float(bound) for bound in range_kpa)
        self._scale, self._shift = 2 / (high - low), (high + low) / (high - low)
        self._shape = modes.shape[1:]
        self._terms = [np.ascontiguousarray(amplitudes_mm), np.ascontiguousarray(modes).reshape(len(modes), -1)]
        if self._terms[1][0].size <= len(modes):  # at few points the polynomials of each are the shorter sum
            self._terms = [np.add.reduce(amplitudes_mm[:, :, None] * self._terms[1], axis=1)]
        self._count = len(amplitudes_mm)

    def value(self, kpa: float) -> Floats:
        t = self._scale * kpa - self._shift
        return self._sum(polynomials(t, self._count))

    def slope(self, kpa: float) -> Floats:
        t = self._scale * kpa - self._shift
        values, slopes = polynomials(t, self._count), [0.0, self._scale]
        while len(slopes) < len(values):
            slopes.append(2 * (self._scale * values[len(slopes) - 1] + t * slopes[-1]) - slopes[-2])
        return self._sum(slopes[: len(values)])

    def _sum(self, weights: list[float]) -> Floats:
        total: Floats = np.array(weights)
        for term in self._terms:
            total = np.einsum("k,kn->n", total, term)
        return total.reshape(self._shape)
