"""A surrogate at fixed points: all that does not depend on the inputs is done once."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.surrogate.basis import Basis, polynomials

Floats = NDArray[np.float64]
Case = float | Floats
"""The value of the one input, as a rule a pressure [kPa], or values (D,) of several."""

STEP = 1e-4  # of a central difference, by the input or 1: error of truncation and of rounding are alike


class Probe(ABC):
    """The displacement of N fixed points as a function of the inputs alone."""

    @abstractmethod
    def value(self, case: Case) -> Floats:
        """Displacement (N, d) [mm] in a case."""

    def slope(self, case: Case) -> Floats:
        """Derivative (N, d) of the displacement by the one input [mm/kPa], or (N, d, D) by each of several.

        Here a central difference.
        """
        if not np.ndim(case):
            return self._difference(case, STEP * max(abs(float(case)), 1.0))
        steps = np.diag(STEP * np.maximum(np.abs(case), 1.0))
        return np.stack([self._difference(case, step) for step in steps], axis=-1)

    def _difference(self, case: Case, step: Case) -> Floats:
        """Central difference quotient along `step`."""
        return (self.value(case + step) - self.value(case - step)) / (2 * np.max(step))

    def values(self, cases: Floats) -> Floats:
        """Displacements (P, N, d) [mm] in cases (P,) of one input or (P, D) of several."""
        if not len(cases):
            return np.empty((0, *self.value(np.zeros(cases.shape[1]) if cases.ndim > 1 else 0.0).shape))
        return np.array([self.value(case if cases.ndim > 1 else float(case)) for case in cases])


class BasisProbe(Probe):
    """Displacements that are a sum of modes whose amplitudes are in the span of a basis of several inputs.

    Parameters
    ----------
    modes
        (K, N, d).
    amplitudes_mm
        (D, K), coefficients of the functions of the basis [mm].
    basis
        The D functions.
    """

    def __init__(self, modes: Floats, amplitudes_mm: Floats, basis: Basis) -> None:
        self._modes, self._amplitudes_mm, self._basis = modes, amplitudes_mm, basis

    def value(self, case: Case) -> Floats:
        weights = np.array(self._basis.terms(list(np.atleast_1d(case))))
        return np.einsum("k,knc->nc", np.einsum("d,dk->k", weights, self._amplitudes_mm), self._modes)


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

    def value(self, case: Case) -> Floats:
        t = self._scale * case - self._shift
        return self._sum(polynomials(t, self._count))

    def slope(self, case: Case) -> Floats:
        t = self._scale * case - self._shift
        values, slopes = polynomials(t, self._count), [0.0, self._scale]
        while len(slopes) < len(values):
            slopes.append(2 * (self._scale * values[len(slopes) - 1] + t * slopes[-1]) - slopes[-2])
        return self._sum(slopes[: len(values)])

    def _sum(self, weights: list[float]) -> Floats:
        total: Floats = np.array(weights)
        for term in self._terms:
            total = np.einsum("k,kn->n", total, term)
        return total.reshape(self._shape)
