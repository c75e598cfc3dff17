"""The journal of a study in PostgreSQL: one row per entry."""

from __future__ import annotations

import json
import re
import select
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from optuna.storages.journal import BaseJournalBackend

from pgdl_lab.core.errors import LabError
from pgdl_lab.search.journal import ends_a_trial

if TYPE_CHECKING:
    from psycopg import Connection

SCHEME = re.compile(r"^postgresql(\+psycopg)?://")
_LOCK = "SELECT pg_advisory_xact_lock(hashtext(%s))"
_TABLE = """CREATE TABLE IF NOT EXISTS pgdl_lab_journal (
    study text, number bigint, entry text NOT NULL, PRIMARY KEY (study, number))"""
_READ = "SELECT entry FROM pgdl_lab_journal WHERE study = %s AND number >= %s ORDER BY number"
_APPEND = """INSERT INTO pgdl_lab_journal
    SELECT %(study)s, coalesce(max(number) + 1, 0), %(entry)s FROM pgdl_lab_journal WHERE study = %(study)s"""

_FLUSH = "SELECT pg_logical_emit_message(true, 'pgdl_lab', '')"
"""Writes nothing but a mark into PostgreSQL's log, whose commit waits until all before it is on the disk."""


class PostgresJournal(BaseJournalBackend):
    """Journal in a table, read or written in one round trip to the server.

    Optuna's own tables take 45 statements in 12 transactions per trial; a journal is replayed in memory. As in a file,
    only the end of a trial waits for the disk.

    Parameters
    ----------
    url
        postgresql://user@host/database, or with "+psycopg" as other programs write it.
    study
        Name of the study; the table holds those of many.
    """

    def __init__(self, url: str, study: str) -> None:
        self._url = SCHEME.sub("postgresql://", url)
        self._study = study
        self._open = self._connect()
        with self._open.transaction():
            self._open.execute(_LOCK, ("",))  # two that make the same table at once would both fail
            self._open.execute(_TABLE)

    def _connect(self) -> Connection[Any]:
        import psycopg

        # A probe every minute keeps firewalls from forgetting the connection during a long trial.
        return psycopg.connect(self._url, autocommit=True, keepalives_idle=60)

    @contextmanager
    def _connection(self) -> Iterator[Connection[Any]]:
        """The connection, or a new one if the server has closed it: it then has sent something unasked."""
        import psycopg

        try:
            if self._open.closed or select.select([self._open], [], [], 0)[0]:
                self._open.close()
                self._open = self._connect()
            yield self._open
        except psycopg.Error as error:
            raise LabError(f"The database of the study does not answer: {str(error).splitlines()[0]}") from error

    def read_logs(self, log_number_from: int) -> list[dict[str, Any]]:
        with self._connection() as connection:
            rows = connection.execute(_READ, (self._study, log_number_from)).fetchall()
        return [json.loads(entry) for (entry,) in rows]

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        with self._connection() as connection, connection.pipeline():
            with connection.transaction():
                # A statement of its own: the next one sees what is there when it begins, and numbers the entry by that.
                connection.execute(_LOCK, (self._study,))
                for log in logs:
                    connection.execute(_APPEND, {"study": self._study, "entry": json.dumps(log, separators=(",", ":"))})
                connection.execute("SET LOCAL synchronous_commit = off")  # nobody waits for the disk behind the lock
            if any(map(ends_a_trial, logs)):
                connection.execute(_FLUSH)
