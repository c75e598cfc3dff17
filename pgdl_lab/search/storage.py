"""Where a study is kept: a journal file in its folder, or a database."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import FileLock

from pgdl_lab.errors import InputError

if TYPE_CHECKING:
    from optuna.storages import BaseStorage


def open_storage(url: str | None, folder: Path) -> BaseStorage:
    """Storage at `url`, or the journal in `folder`.

    Raises
    ------
    InputError
        If the database cannot be opened.
    """
    from optuna.storages import JournalStorage, RDBStorage
    from optuna.storages.journal import JournalFileBackend
    from optuna.storages.journal._file import BaseJournalFileLock

    class KernelLock(BaseJournalFileLock):
        """Lock that the kernel takes back from a killed process at once; Optuna's own have to wait for 30 s."""

        def __init__(self, path: Path) -> None:
            self._lock = FileLock(path)

        def acquire(self) -> bool:
            self._lock.acquire()
            return True

        def release(self) -> None:
            self._lock.release()

    if url is None:
        file = folder / "study.journal"
        return JournalStorage(JournalFileBackend(str(file), KernelLock(folder / ".journal.lock")))
    shown = re.sub(r"//([^:/@]*):[^@/]*@", r"//\1:***@", url)
    try:
        with FileLock(folder / ".storage.lock"):  # the first to come makes the tables
            return RDBStorage(url, engine_kwargs={"pool_pre_ping": True})
    except ImportError as error:
        raise InputError(
            f"hydra.sweeper.storage={shown} needs a Python package that is not installed: for postgresql+psycopg://… "
            "it is 'pip install psycopg[binary]'."
        ) from error
    except Exception as error:  # each database has errors of its own
        reason = " ".join(str(error).splitlines()[:1])
        raise InputError(f"hydra.sweeper.storage={shown} cannot be opened: {reason}") from error
