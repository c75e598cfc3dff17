"""Polynomials in the inputs that some cases determine."""

from __future__ import annotations

import logging

import numpy as np

from pgdl_lab.core.inputs import PRESSURE, Cases
from pgdl_lab.surrogate.basis import Basis

_log = logging.getLogger(__name__)

MOST = 28  # polynomials in several inputs: solves cost the cube of their number


def basis_of(cases: Cases, degree: int) -> Basis:
    """Products of polynomials of total degree `degree`, from no pressure on and between the values of other inputs.

    Of several inputs an input's own degree is below the number of its values, and the total degree is lowered until
    there are `MOST` of them at most.
    """
    ranges = [(0.0 if name == PRESSURE else low, high) for name, (low, high) in cases.ranges().items()]
    if len(ranges) == 1:
        return Basis.of(ranges, degree)
    most = [len(np.unique(values)) - 1 for values in cases.values.T]
    lowered = degree
    while len((basis := Basis.within(ranges, most, lowered)).degrees) > MOST and lowered > 1:
        lowered -= 1
    if lowered < degree:
        _log.info("model.degree is lowered from %d to %d, as there are %d inputs.", degree, lowered, len(ranges))
    return basis
