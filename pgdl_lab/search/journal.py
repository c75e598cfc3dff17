"""The journal of a study as a file in its folder, and the lock that keeps its writers apart."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from optuna.storages.journal import JournalFileBackend
from optuna.storages.journal._file import BaseJournalFileLock
from optuna.storages.journal._storage import JournalOperation


class KernelLock(BaseJournalFileLock):
    """Lock on a file that the kernel hands on in turn, without polling, and takes back from a killed process at once.

    Optuna's own locks of a killed process have to wait for 30 s, and to try again every few milliseconds keeps many
    workers from ever getting their turn.

    Parameters
    ----------
    path
        The file; it stays.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = -1

    def acquire(self) -> bool:
        file = os.open(self._path, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        except BaseException:
            os.close(file)
            raise
        self._file = file
        return True

    def release(self) -> None:
        os.close(self._file)

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


class FileJournal(JournalFileBackend):
    """Journal that waits for the disk only where a trial ends.

    What was written before a process is killed is kept by the kernel. When the whole machine fails, trials that were
    begun in the last seconds may be missing, which then are run again; Optuna waits for the disk six times per trial.

    Parameters
    ----------
    folder
        Folder of the study.
    """

    def __init__(self, folder: Path) -> None:
        self._own_lock = KernelLock(folder / ".journal.lock")
        self._own_path = folder / "study.journal"
        super().__init__(str(self._own_path), self._own_lock)
        with self._own_lock, self._own_path.open("rb+") as file:
            whole = file.read().rfind(b"\n") + 1
            file.truncate(whole)  # a machine that fails may leave half a line

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs)
        with self._own_path.open("ab") as file:
            with self._own_lock:
                file.write(lines.encode())
                file.flush()
            if any(map(ends_a_trial, logs)):
                os.fsync(file.fileno())


def ends_a_trial(log: Mapping[str, Any]) -> bool:
    """Whether an entry of a journal tells how a trial ended: it must not be lost when the machine fails."""
    return bool(log["op_code"] == JournalOperation.SET_TRIAL_STATE_VALUES)
