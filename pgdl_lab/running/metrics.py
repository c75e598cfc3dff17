"""The numbers in metrics.json, by dotted keys."""

from collections.abc import Iterator, Mapping
from typing import Any


def numbers(tree: Any, key: str = "") -> Iterator[tuple[str, float]]:
    """Dotted keys and values of the numbers in a JSON tree; the entries of a list are numbered from 0."""
    if isinstance(tree, Mapping | list):
        for name, child in tree.items() if isinstance(tree, Mapping) else enumerate(tree):
            yield from numbers(child, f"{key}.{name}" if key else str(name))
    elif isinstance(tree, int | float) and not isinstance(tree, bool):
        yield key, float(tree)
