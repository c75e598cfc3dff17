"""Where a study is kept: a journal in its folder or in PostgreSQL, or the tables of another database."""

from __future__ import annotations

import re
from pathlib import Path

from optuna.storages import BaseStorage, JournalStorage, RDBStorage

from pgdl_lab.core.errors import InputError
from pgdl_lab.search.journal import FileJournal, KernelLock
from pgdl_lab.search.postgresql import SCHEME, PostgresJournal


def open_storage(url: str | None, folder: Path) -> BaseStorage:
    """Storage at `url`, or the journal in `folder`.

    In a database a study goes by the name of its folder.

    Raises
    ------
    InputError
        If the database cannot be opened.
    """
    if url is None:
        return JournalStorage(FileJournal(folder))
    shown = re.sub(r"//([^:/@]*):[^@/]*@", r"//\1:***@", url)
    try:
        if SCHEME.match(url):
            return JournalStorage(PostgresJournal(url, folder.name))
        with KernelLock(folder / ".storage.lock"):  # the first to come makes the tables
            return RDBStorage(url, engine_kwargs={"pool_pre_ping": True})
    except ImportError as error:
        raise InputError(
            f"hydra.sweeper.storage={shown} needs a Python package that is not installed: for postgresql://… "
            "it is 'pip install psycopg[binary]'."
        ) from error
    except Exception as error:  # each database has errors of its own
        reason = " ".join(str(error).splitlines()[:1])
        raise InputError(f"hydra.sweeper.storage={shown} cannot be opened: {reason}") from error
