"""A PostgreSQL server of one's own, for tests and benchmarks."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def programs() -> Path | None:
    """Folder of PostgreSQL's programs, which Debian keeps off the path; None where they are not installed."""
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    found = str(debian[-1]) if debian else shutil.which("initdb")
    return Path(found).parent if found else None


@contextmanager
def server(folder: Path, *settings: str) -> Iterator[str]:
    """URL of an empty database, whose server ends with the block.

    Parameters
    ----------
    folder
        Where its files go; the two folders above are opened to the user postgres, as the server refuses to run as root.
    settings
        Settings of the server, such as "fsync=off".
    """
    place = programs()
    assert place is not None
    data = folder / "postgres"
    data.mkdir()
    user: dict[str, Any] = {"user": "postgres", "group": "postgres", "cwd": "/"} if os.geteuid() == 0 else {}
    if user:
        shutil.chown(data, "postgres", "postgres")
        for above in (folder, *folder.parents[:2]):
            above.chmod(above.stat().st_mode | 0o011)

    def call(program: str, *arguments: str) -> None:
        subprocess.run([str(place / program), "-D", str(data), *arguments], check=True, capture_output=True, **user)

    call("initdb", "-A", "trust", "-U", "lab", "--no-sync")
    options = " ".join([f"-k {data} -c listen_addresses=''", *(f"-c {setting}" for setting in settings)])
    call("pg_ctl", "-w", "-o", options, "-l", str(data / "log"), "start")
    try:
        yield f"postgresql+psycopg://lab@/postgres?host={data}"
    finally:
        call("pg_ctl", "-m", "immediate", "stop")
