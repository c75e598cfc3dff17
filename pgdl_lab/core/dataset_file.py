"""The HDF5 file of a dataset: a tree of arrays and of JSON values, written whole or not at all, read as data only."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.hdf5 import require_contained
from pgdl_lab.core.inputs import pressure

FORMAT = "pgdl_lab dataset"
VERSION = 2
DISPLACEMENT = "displacement_mm"  # the field that every dataset has
TANGENT = "tangent_mm_per_kpa"  # its derivative by the pressure, where the equilibria were solved for
FORMAT_1 = "pgdl_lab snapshots"  # of version 1: the side face at rising pressures
DTYPES = (np.float64, np.int64)
BUSY_S = 10.0  # for which another program may write to a file
GLANCE_S = 0.2

Tree = dict[str, Any]
"""Arrays, JSON values and trees by name."""


class DamagedDataset(LabError):
    """A file that does not hold a dataset, or not whole."""


def unreadable(path: Path, error: Exception) -> DamagedDataset:
    """What to raise when something in a file is missing or of another kind."""
    return DamagedDataset(f"{path} is no readable dataset, it may be truncated or foreign ({error}).")


def write(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a file with what describes a dataset."""
    with writing(path) as file:
        file.attrs.update(format=FORMAT, version=VERSION)
        _write(file, tree)


def read(path: Path) -> Tree:
    """What `write` wrote, or what a file of version 1 says in its words.

    Raises
    ------
    DamagedDataset
        When the file is truncated, altered or not one of ours.
    LabError
        When it cannot be opened now.
    """
    try:
        with _opened(path) as file:
            require_contained(file)
            kind, version = file.attrs.get("format"), file.attrs.get("version")
            if kind not in (FORMAT, FORMAT_1):
                raise DamagedDataset(f"{path} is an HDF5 file, but does not hold a dataset of pgdl_lab.")
            if (kind, version) == (FORMAT, VERSION):
                return _read(file)
            if (kind, version) == (FORMAT_1, 1):
                return _read_1(file)
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise unreadable(path, error) from error
    raise DamagedDataset(
        f"{path} has version {version} of the format, but this is version {VERSION}; delete it to compute it again."
    )


@contextmanager
def writing(path: Path) -> Iterator[Any]:
    """An open HDF5 file that appears at `path` when it is whole.

    It is made in memory: where a disk is full, HDF5 ends the whole process.
    """
    import h5py

    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        yield file
        file.flush()
        image = file.id.get_file_image()
    with replacing(path) as temporary:
        temporary.write_bytes(image)


def _opened(path: Path) -> Any:
    """The open HDF5 file, after a while if another program writes to it."""
    import h5py

    until = time.monotonic() + BUSY_S
    while True:
        try:
            return h5py.File(path, "r")
        except BlockingIOError as error:
            if time.monotonic() > until:
                raise LabError(
                    f"{path} is held by another program that may write to it, such as a viewer of HDF5 files or a "
                    "Python session: close it there."
                ) from error
        except OSError as error:
            if error.errno is None:  # HDF5 itself, about what is in the file
                raise
            raise LabError(
                f"{path} cannot be opened ({os.strerror(error.errno)}): check the file and who may read it."
            ) from error
        time.sleep(GLANCE_S)


def _write(group: Any, tree: Mapping[str, Any]) -> None:
    for name, value in tree.items():
        if isinstance(value, np.ndarray):
            # The checksum needs chunks; a chunk of one case is what readers ask for.
            chunks = (1, *value.shape[1:]) if value.ndim == 3 else value.shape
            group.create_dataset(name, data=value, chunks=chunks if value.size else None, fletcher32=bool(value.size))
        elif isinstance(value, dict) and any(isinstance(each, np.ndarray) for each in value.values()):
            _write(group.create_group(name), value)
        else:
            group.attrs[name] = json.dumps(value)


def _read(group: Any) -> Tree:
    known = {name: json.loads(value) for name, value in group.attrs.items() if name not in ("format", "version")}
    return known | {name: _read(each) if hasattr(each, "keys") else _array(each) for name, each in group.items()}


def _read_1(file: Any) -> Tree:
    arrays = {name: _array(each) for name, each in file.items() if name != "body"}
    face = _path(arrays["points"], arrays["triangles"], "triangle", arrays)
    tree = face | {name: arrays[name] for name in ("base", "clamp")}
    tree["provenance"] = json.loads(file.attrs["provenance"])
    if "body" in file:
        body = {name: _array(each) for name, each in file["body"].items()}
        tree["body"] = _path(body["positions"], body["cells"], str(file["body"].attrs["cell_type"]), body)
    return tree


def _path(points: NDArray[Any], cells: NDArray[Any], cell_type: str, arrays: Tree) -> Tree:
    """The tree of one simulation at rising pressures, without a base line."""
    kpa, none = arrays["pressures_kpa"], np.empty(0, dtype=np.int64)
    inputs = [asdict(each) for each in pressure(float(kpa.max(initial=0.0)))]
    return {
        "provenance": {}, "cell_type": cell_type, "inputs": inputs, "points_mm": points, "cells": cells, "base": none,
        "clamp": none, "cases": kpa[:, None], "simulation": np.zeros(len(kpa), dtype=np.int64),
        "fields": {DISPLACEMENT: arrays["displacements"]},
    }  # fmt: skip


def _array(stored: Any) -> NDArray[Any]:
    array: NDArray[Any] = stored[()]
    if array.dtype not in DTYPES:
        raise ValueError(f"'{stored.name}' is of type {array.dtype}")
    return array
