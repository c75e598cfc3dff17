"""What arrays of a file must look like: one that is not ours is refused when it is read, not when it is used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

FLOATS, INDICES = ("float32", "float64"), ("int64",)
Shapes = Mapping[str, tuple[tuple[str, ...], *tuple[str | int, ...]]]
"""Types and length of each axis by the name of the array; a letter is the same length wherever it stands."""


def require(arrays: Mapping[str, NDArray[Any]], expected: Shapes) -> None:
    """Check the arrays that are there.

    Raises
    ------
    ValueError
        When one has another type or shape, or an axis without entries.
    """
    lengths: dict[str, int] = {}
    for name in expected.keys() & arrays.keys():
        array, (types, *shape) = arrays[name], expected[name]
        if array.dtype.name not in types or array.ndim != len(shape) or 0 in array.shape:
            raise ValueError(f"{name} is {array.dtype} {array.shape}")
        for found, wanted in zip(array.shape, shape, strict=True):
            if found != (wanted if isinstance(wanted, int) else lengths.setdefault(wanted, found)):
                raise ValueError(f"{name} is {array.shape}")
