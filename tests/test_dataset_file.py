"""Files of datasets that someone made to do harm: each is refused before it is read."""

import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import DamagedDataset
from tests.test_dataset import small


def _put(name: str, **settings: Any) -> Callable[[h5py.File], None]:
    """Put another array in the place of one."""

    def put(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, **{"dtype": "f8", **settings})

    return put


def _set(name: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[name][0, 0] = value

    return change


def _linked(file: h5py.File) -> None:
    del file["points_mm"]
    file["points_mm"] = h5py.ExternalLink("whole.h5", "/points_mm")


def _virtual(file: h5py.File) -> None:
    del file["points_mm"]
    layout = h5py.VirtualLayout((5, 2), float)
    layout[:] = h5py.VirtualSource("whole.h5", "points_mm", (5, 2))
    file.create_virtual_dataset("points_mm", layout)


def _named_often(file: h5py.File) -> None:
    for number in range(4000):
        file[str(number)] = file["fields/displacement_mm"]


HOSTILE: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "shape": (
        _put("fields/displacement_mm", shape=(3, 10**8, 2), chunks=(1, 1000, 2)),
        "ask for 4,800,.* explain at most",
    ),
    "piece": (
        _put("fields/displacement_mm", shape=(3, 5, 2), maxshape=(None,) * 3, chunks=(1, 10**8, 2)),
        "up to 'fields/displacement_mm' its arrays ask for 1,600,000",
    ),
    "linked": (_linked, "'points_mm' is a link to the file 'whole.h5'"),
    "outside": (_put("points_mm", shape=(5, 2), external=[("/etc/passwd", 0, 80)]), "its numbers in other files"),
    "virtual": (_virtual, "'points_mm' keeps its numbers in other files"),
    "objects": (_put("points_mm", shape=(5, 2), dtype=h5py.vlen_dtype(np.float64)), "'points_mm' holds objects"),
    "references": (_put("points_mm", shape=(5, 2), dtype=h5py.ref_dtype), "'points_mm' holds objects"),
    "texts": (_put("points_mm", shape=(5, 2), dtype=h5py.string_dtype()), "'.*points_mm' is of type object"),
    "attribute": (lambda file: file.attrs.update(version=np.array(["1"] * 2, dtype=object)), "'version' holds objects"),
    "packed": (_put("points_mm", data=np.zeros((5, 2)), compression="gzip"), "'points_mm' is packed"),
    "named often": (_named_often, "its arrays ask for"),
    "integers": (_put("points_mm", data=np.zeros((5, 2)), dtype="i8"), "do not fit together"),
    "no provenance": (lambda file: file.attrs.update(provenance="[]"), "do not fit together"),
    "negative": (_set("cells", -1), "do not fit together"),
    "not finite": (_set("points_mm", np.nan), "do not fit together"),
    "no node": (_set("body/cells", 99), "do not fit together"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_are_refused_before_they_are_read(case: str, tmp_path: Path) -> None:
    change, words = HOSTILE[case]
    small().save(tmp_path / "whole.h5")
    shutil.copy(tmp_path / "whole.h5", tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        change(file)
    tracemalloc.start()
    with pytest.raises(DamagedDataset, match=rf"a\.h5 .*{words}"):
        Dataset.load(tmp_path / "a.h5")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 5_000_000
