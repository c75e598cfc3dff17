"""The files of a surrogate: named arrays and one text in JSON, in formats that cannot hold code.

A .pt is in the safetensors format, a .npz in NumPy's, which NumPy alone reads. Both hold numbers as they lie in memory,
so that what is read takes what the file takes; one that promises more is refused before anything is set aside for it.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import stat
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing

Arrays = Mapping[str, NDArray[Any]]

ABOUT = "about"  # name of the text
DIGEST = "sha256"  # name of the checksum of text and arrays, as the safetensors format has none
GROUPS = ("state", "face")  # of the arrays, which are called "state/…" and "face/…"
HDF5 = b"\x89HDF\r\n\x1a\n"  # begins such a file
HEADER_BYTES = 8  # that tell how long the header of a safetensors file is
NAMED = 300  # bytes of a file of torch.save that name its first entry
LONGEST = 160  # characters of a reason that are told


def write(path: Path, about: Mapping[str, Any], **groups: Arrays) -> None:
    """Write a .npz, or a file in the safetensors format; it appears only when it is complete.

    Parameters
    ----------
    path
        The file.
    about
        What is no array, in JSON types.
    **groups
        Arrays by group.
    """
    arrays = {f"{group}/{name}": np.array(array, order="C")
              for group, members in groups.items() for name, array in members.items()}  # fmt: skip
    with replacing(path) as temporary, temporary.open("wb") as file:
        if path.suffix == ".npz":
            entries: dict[str, Any] = {ABOUT: np.array(json.dumps(about)), **arrays}
            np.savez(file, **entries)
        else:
            file.write(safetensors(about, arrays))


def safetensors(about: Any, arrays: Arrays) -> bytes:
    """A file in the safetensors format, with a checksum."""
    from safetensors.numpy import save

    text = json.dumps(about)
    return save(dict(arrays), {ABOUT: text, DIGEST: _digest(text, arrays)})


def read(path: Path) -> dict[str, Any]:
    """What `write` was given: the entries of "about", and the arrays of each group.

    Raises
    ------
    InputError
        When there is no such file, or it is damaged, foreign or of an earlier version of pgdl_lab.
    """
    data = _bytes(path)
    if data.startswith(HDF5):
        raise InputError(
            f"{path} is no surrogate but an HDF5 file, such as the snapshots of a simulation: open it by "
            "pgdl_lab.Dataset.load or h5py, and give the surrogate.pt of a run here."
        )
    zipped = data.startswith(b"PK")
    if zipped and b"/data.pkl" in data[:NAMED]:
        raise InputError(
            f"{path} was written by an earlier pgdl_lab as a pickle, a format that can hold code and is no longer "
            "opened: train it again, which takes its simulation from the cache, or load the .npz that was exported."
        )
    try:
        text, arrays = _plain(data) if zipped or path.suffix == ".npz" else _safetensors(data)
        content: dict[str, Any] = {**json.loads(text), **{group: {} for group in GROUPS}}
        for name, array in arrays.items():
            group, _, member = name.partition("/")
            content[group][member] = array
        return content
    except Exception as error:  # foreign bytes make the libraries trip in many ways
        raise InputError(
            f"{path} is damaged or not a surrogate of pgdl_lab ({reason(error)}): give another file, or train or "
            "export it again."
        ) from error


def reason(error: Exception) -> str:
    """What an error says, in a part of a line."""
    told = " ".join(str(error).split()) or type(error).__name__
    return told if len(told) <= LONGEST else f"{told[:LONGEST]} …"


def _bytes(path: Path) -> bytes:
    try:
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise InputError(f"The surrogate {path} cannot be read: it is a device or a pipe, which may never end.")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"The surrogate {path} cannot be read: {error.strerror}.") from error
    except MemoryError as error:
        size = path.stat().st_size
        raise InputError(f"The surrogate {path} cannot be read: its {size:,} bytes exceed the memory.") from error


def _safetensors(data: bytes) -> tuple[str, dict[str, NDArray[Any]]]:
    from safetensors.numpy import load

    length = int.from_bytes(data[:HEADER_BYTES], "little")
    if not 0 < length <= len(data) - HEADER_BYTES:
        raise ValueError(f"its header is said to take {length:,} bytes, and the file has {len(data):,}")
    header = json.loads(data[HEADER_BYTES : HEADER_BYTES + length])
    metadata = header.pop("__metadata__")
    for name, entry in header.items():
        _require_room(name, entry["shape"], 1, len(data))
    arrays = load(data)  # checks that they cover the file, each once
    if metadata[DIGEST] != _digest(metadata[ABOUT], arrays):
        raise ValueError("its numbers are not those that were written")
    return metadata[ABOUT], arrays


def _plain(data: bytes) -> tuple[str, dict[str, NDArray[Any]]]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        unpacked = sum(info.file_size for info in archive.infolist())
        if unpacked > len(data):  # they are compressed, or lie over each other
            raise ValueError(f"its entries take {unpacked:,} bytes unpacked, and the file has {len(data):,}")
        entries = {info.filename.removesuffix(".npy"): archive.read(info) for info in archive.infolist()}
    arrays = {name: _array(name, entry) for name, entry in entries.items()}
    return str(arrays.pop(ABOUT)), arrays


def _array(name: str, data: bytes) -> NDArray[Any]:
    """The array in a .npy file, which holds as many numbers as it says."""
    file = io.BytesIO(data)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, by_column, dtype = readers[np.lib.format.read_magic(file)](file)
    if dtype.hasobject:
        raise ValueError(f"'{name}' holds objects instead of numbers")
    _require_room(name, shape, dtype.itemsize, len(data) - file.tell())
    numbers = np.frombuffer(data, dtype, math.prod(shape), file.tell())
    return numbers.reshape(shape, order="F" if by_column else "C").copy()


def _digest(text: str, arrays: Arrays) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(arrays[name].data)
    return digest.hexdigest()


def _require_room(name: str, shape: list[int] | tuple[int, ...], size: int, held: int) -> None:
    """Check that `held` bytes can hold an array whose numbers take `size` bytes each.

    Raises
    ------
    ValueError
        When they cannot.
    """
    promised = math.prod(shape) * size
    if promised > held:
        by = " × ".join(map(str, shape))
        raise ValueError(f"'{name}' is said to be {by} numbers of {size} bytes or more, and there are {held:,} bytes")
