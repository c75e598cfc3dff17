"""Questions to a surrogate, checked: points in mm, pressures in kPa and other inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import unit_of
from pgdl_lab.core.simplices import AXES

Floats = NDArray[np.float64]
Asked = ArrayLike | Mapping[str, ArrayLike]
"""A pressure [kPa] or several (P,), or numbers or (P,) of each input by its name."""


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


def cases_of(asked: Asked, names: Sequence[str]) -> tuple[Floats, bool]:
    """Cases, (P,) of one input or (P, D) of several, and whether one was asked for alone.

    Parameters
    ----------
    asked
        Numbers or (P,) of each input by its name; where there is one input, without its name too.
    names
        The D inputs.

    Raises
    ------
    InputError
        When an input is missing or unknown, a shape is wrong, or a value is no finite number.
    """
    if not isinstance(asked, Mapping):
        if len(names) > 1:
            raise InputError(
                f"This surrogate has {len(names)} inputs: give each by its name, as in "
                f"{{{', '.join(f'{name!r}: …' for name in names)}}}."
            )
        single = _values(asked, names[0])
        return np.atleast_1d(single), not single.ndim
    if set(asked) != set(names):
        missing = [name for name in names if name not in asked]
        unknown = [str(name) for name in asked if name not in names]
        told = f"{', '.join(missing)} is missing" if missing else f"{', '.join(unknown)} is unknown"
        raise InputError(f"{told}: give {', '.join(names)}.")
    columns = [_values(asked[name], name) for name in names]
    lengths = {len(column) for column in columns if column.ndim}
    if len(lengths) > 1:
        raise InputError(
            f"The inputs have {' and '.join(map(str, sorted(lengths)))} values; give as many of each, or one."
        )
    cases = np.stack(np.broadcast_arrays(*map(np.atleast_1d, columns)), axis=1)
    return (cases[:, 0] if len(names) == 1 else cases), not lengths


def _values(given: ArrayLike, name: str) -> Floats:
    """Values () or (P,) of an input."""
    values = _numbers(given, name)
    if values.ndim > 1:
        unit = f", in {unit_of(name)}" if unit_of(name) else ""
        raise InputError(f"{name} has shape {values.shape}; it must be a number or (P,){unit}.")
    return values


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
