"""Reading what `torch.save` wrote without torch: plain data and arrays, and never any code.

A file is a zip archive of one pickle and the raw numbers of each tensor. The pickle may name nothing but tensors; one
that asks for anything else is refused.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError

STORAGES = {
    "DoubleStorage": np.float64,
    "FloatStorage": np.float32,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "BoolStorage": np.bool_,
}


def read_archive(path: Path, what: str) -> Any:
    """The content of a file of `torch.save`, tensors as arrays.

    Parameters
    ----------
    path
        The file.
    what
        What it should be, for messages.

    Raises
    ------
    InputError
        When there is no such file, or it is damaged or foreign.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"The {what} {path} cannot be read: {error.strerror}.") from error
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _unpickled(archive)
    except Exception as error:  # foreign bytes make zipfile and pickle trip in many ways
        raise InputError(f"{path} is damaged or not a {what} of pgdl_lab; give another file or train again.") from error


def _unpickled(archive: zipfile.ZipFile) -> Any:
    members = {name.partition("/")[2]: name for name in archive.namelist()}

    def read(member: str) -> bytes:
        info = archive.getinfo(members[member])
        if info.compress_type != zipfile.ZIP_STORED:  # torch stores; a small file that swells is none of ours
            raise ValueError(f"{member} is compressed")
        return archive.read(info)

    if "byteorder" in members and read("byteorder") != b"little":
        raise ValueError("big-endian numbers")
    return _Unpickler(read).load()


class _Unpickler(pickle.Unpickler):
    """Knows tensors and nothing else.

    Parameters
    ----------
    read
        Gives the bytes of a member of the archive; the checksum is compared.
    """

    def __init__(self, read: Callable[[str], bytes]) -> None:
        super().__init__(io.BytesIO(read("data.pkl")))
        self._read = read

    def find_class(self, module_name: str, global_name: str) -> Any:
        if (module_name, global_name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if module_name == "torch" and global_name in STORAGES:
            return STORAGES[global_name]
        if (module_name, global_name) == ("collections", "OrderedDict"):
            return OrderedDict
        raise pickle.UnpicklingError(f"{module_name}.{global_name} is no part of a surrogate")

    def persistent_load(self, pid: Any) -> NDArray[Any]:
        _, dtype, key, _, _ = pid
        return np.frombuffer(self._read(f"data/{key}"), dtype=np.dtype(dtype).newbyteorder("<"))


def _tensor(
    storage: NDArray[Any], offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> NDArray[Any]:
    """A tensor from its numbers; one that would reach beyond them is refused."""
    last = offset + sum((count - 1) * step for count, step in zip(size, stride, strict=True))
    if min((offset, *size, *stride)) < 0 or (np.prod(size) > 0 and last >= len(storage)):
        raise ValueError("a tensor reaches beyond its numbers")
    steps = [step * storage.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps).copy()
