"""A PostgreSQL server of one's own, for tests and benchmarks."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.needs import program


@contextmanager
def server(*settings: str) -> Iterator[str]:
    """URL of an empty database, whose server ends with the block.

    Parameters
    ----------
    settings
        Settings of the server, such as "fsync=off".
    """
    initdb = program("initdb")
    assert initdb is not None
    with tempfile.TemporaryDirectory() as data:  # not in a folder of pytest, which every session closes to other users
        user: dict[str, Any] = {}
        if os.geteuid() == 0:  # the server refuses to run as root
            shutil.chown(data, "postgres", "postgres")
            user = {"user": "postgres", "group": "postgres", "cwd": "/"}

        def call(name: str, *arguments: str) -> None:
            command = [str(Path(initdb).with_name(name)), "-D", data, *arguments]
            done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **user)
            if done.returncode:
                raise RuntimeError(f"{name} failed: {done.stdout}")

        call("initdb", "-A", "trust", "-U", "lab", "--no-sync")
        options = " ".join([f"-k {data} -c listen_addresses=''", *(f"-c {setting}" for setting in settings)])
        call("pg_ctl", "-w", "-o", options, "-l", f"{data}/log", "start")
        try:
            yield f"postgresql+psycopg://lab@/postgres?host={data}"
        finally:
            call("pg_ctl", "-m", "immediate", "stop")
