"""Questions to a surrogate, checked: points in mm and pressures in kPa."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.simplices import AXES

Floats = NDArray[np.float64]


def points_of(points_mm: ArrayLike, dimension: int) -> Floats:
    """Points (N, d) [mm] of a face (d = 2) or of a body (d = 3).

    Raises
    ------
    InputError
        When the shape is another, or a value is no finite number.
    """
    points = _numbers(points_mm, "points_mm")
    if points.ndim != 2 or points.shape[1] != dimension:
        *first, last = list(AXES[dimension])
        raise InputError(
            f"points_mm has shape {points.shape}; it must be (N, {dimension}): {', '.join(first)} and {last} of N "
            "points in mm."
        )
    return points


def pressures_of(pressure_kpa: ArrayLike) -> Floats:
    """Pressures () or (P,) [kPa].

    Raises
    ------
    InputError
        When the shape is another, or a value is no finite number.
    """
    pressures = _numbers(pressure_kpa, "pressure_kpa")
    if pressures.ndim > 1:
        raise InputError(f"pressure_kpa has shape {pressures.shape}; it must be a number or (P,), in kPa.")
    return pressures


def _numbers(values: ArrayLike, name: str) -> Floats:
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "fiu":
            raise TypeError(f"they are of type {given.dtype}")
        numbers = given.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} cannot be read as numbers ({error}).") from error
    if not np.isfinite(numbers).all():
        raise InputError(f"{name} holds {int((~np.isfinite(numbers)).sum())} values that are not finite; remove them.")
    return numbers
