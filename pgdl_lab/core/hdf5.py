"""HDF5 files from others: what they hold lies in them, as plain numbers and text, and is no larger than they are."""

import math
import os
from collections.abc import Iterable, Iterator
from typing import Any

PLAIN_FILTERS = frozenset({3})  # HDF5's checksum
PACKING_FILTERS = frozenset({1, 2, 3})  # deflate and the sorting of bytes before it too
SWELLS = 100  # times that numbers of a mesh may be packed


def require_contained(file: Any, packed: bool = False) -> None:
    """Check every array of an open HDF5 file, before one is read.

    HDF5 sets aside what the shape of an array asks for, whether or not there are numbers, and reads other files that
    a link or an array names.

    Parameters
    ----------
    file
        An `h5py.File`.
    packed
        Whether arrays may be compressed.

    Raises
    ------
    ValueError
        When something lies outside the file, is no number or text, or asks for more memory than the file explains.
    """
    import h5py

    size = os.path.getsize(file.filename)
    limit = SWELLS * size if packed else size
    filters = PACKING_FILTERS if packed else PLAIN_FILTERS
    asked = 0
    for name, item in _items(file):
        asked += sum(_attributes(item))
        if hasattr(item, "chunks"):
            asked += max(_bytes(item.shape, item.dtype), _chunk_bytes(item))
            if item.external or item.is_virtual:
                raise ValueError(f"'{name}' keeps its numbers in other files")
            if item.dtype.hasobject and h5py.check_string_dtype(item.dtype) is None:
                raise ValueError(f"'{name}' holds objects")
            if not set(_filters(item)) <= filters:
                raise ValueError(f"'{name}' is packed, which is not read here")
        if asked > limit:
            raise ValueError(f"up to '{name}' its arrays ask for {asked:,} bytes, and the {size:,} of the file explain "
                             f"at most {limit:,}")  # fmt: skip


def _items(file: Any) -> Iterator[tuple[str, Any]]:
    """Every group and array by every name that it has, the file itself first."""
    import h5py

    links: list[tuple[str, Any]] = []
    file.visititems_links(lambda name, link: links.append((name, link)))
    yield "/", file
    for name, link in links:
        if isinstance(link, h5py.ExternalLink):
            raise ValueError(f"'{name}' is a link to the file '{link.filename}'")
        item = file.get(name)
        if item is not None:  # a link within the file may lead nowhere
            yield name, item


def _attributes(item: Any) -> Iterator[int]:
    """What each attribute takes; one text of any length lies in the file, many may be the same one."""
    for name in getattr(item, "attrs", ()):
        attribute = item.attrs.get_id(name)
        if attribute.dtype.hasobject and attribute.shape != ():
            raise ValueError(f"the attribute '{name}' holds objects")
        yield _bytes(attribute.shape, attribute.dtype)


def _bytes(shape: tuple[int, ...] | None, dtype: Any) -> int:
    return 0 if shape is None else math.prod(shape) * int(dtype.itemsize)


def _chunk_bytes(dataset: Any) -> int:
    """What a piece takes that is read at once, as it is and as it is stored."""
    return max(_bytes(dataset.chunks, dataset.dtype), int(dataset.id.get_storage_size()))


def _filters(dataset: Any) -> Iterable[int]:
    settings = dataset.id.get_create_plist()
    return (int(settings.get_filter(number)[0]) for number in range(settings.get_nfilters()))
