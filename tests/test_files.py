"""Files are whole or not there, also where a disk is full or another program holds one."""

import fcntl
import resource
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from pgdl_lab.core import dataset_file, files
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import DamagedDataset
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.running.cache import simulate
from tests.fingers import OBSERVATION, pneunet
from tests.test_dataset import Counting, small


@contextmanager
def room(size: int) -> Iterator[None]:
    """No file of this process may become larger than `size` bytes, as on a disk that is full then."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 1000, 5000])
def test_no_room_for_snapshots_is_one_sentence_and_nothing_remains(size: int, tmp_path: Path) -> None:
    with room(size), pytest.raises(LabError, match=f"There is no room left in {tmp_path}: free some"):
        small().save(tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_no_room_leaves_the_earlier_file(tmp_path: Path) -> None:
    small().save(tmp_path / "a.h5")
    before = (tmp_path / "a.h5").read_bytes()
    with room(100), pytest.raises(LabError, match="no room"):
        small().save(tmp_path / "a.h5")
    assert (tmp_path / "a.h5").read_bytes() == before


def test_errors_of_libraries_on_a_full_disk_are_told_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for free, expected in ((10**9, RuntimeError), (0, LabError)):
        monkeypatch.setattr(files, "disk_usage", lambda folder, free=free: SimpleNamespace(free=free))
        with pytest.raises(expected), replacing(tmp_path / "a.pt") as temporary:
            temporary.write_bytes(b"half of")
            raise RuntimeError("unexpected pos 576 vs 534")
        assert list(tmp_path.iterdir()) == []


@contextmanager
def held(path: Path) -> Iterator[None]:
    """As another program holds a file that it writes to."""
    with path.open("r+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def test_a_dataset_that_another_program_holds_is_not_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset_file, "BUSY_S", 0.3)
    fem = Counting(notes=str(tmp_path / "notes"))
    _, path, _ = simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")
    with held(path), pytest.raises(LabError, match=r"is held by another program .*: close it there") as told:
        simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")
    assert not isinstance(told.value, DamagedDataset)
    assert not list((tmp_path / "cache").glob("*.damaged"))
    assert simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")[2]
    assert len((tmp_path / "notes").read_text().split()) == 1


def test_dataset_are_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    small().save(path)
    begun = threading.Event()

    def hold() -> None:
        with held(path):
            begun.set()
            time.sleep(0.3)

    thread = threading.Thread(target=hold)
    thread.start()
    begun.wait()
    assert len(Dataset.load(path).pressures_kpa) == 3
    thread.join()


def test_a_file_that_cannot_be_opened_is_not_called_damaged(tmp_path: Path) -> None:
    (tmp_path / "a.h5").symlink_to("a.h5")
    with pytest.raises(LabError, match=r"a\.h5 cannot be opened \(Too many levels of symbolic links\)") as told:
        Dataset.load(tmp_path / "a.h5")
    assert not isinstance(told.value, DamagedDataset)
