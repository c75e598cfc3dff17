"""Files appear only when they are whole."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import disk_usage

from pgdl_lab.core.errors import LabError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
LITTLE = 2**16  # bytes that are left where a library failed with an error of its own, for want of more


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name in the folder of `path`; it takes the place of `path` when the block ends well.

    A block that fails leaves `path` as it was and removes the temporary file.

    Raises
    ------
    LabError
        When there is no room left.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        os.replace(temporary, path)
    except Exception as error:
        full = error.errno in FULL if isinstance(error, OSError) else disk_usage(path.parent).free < LITTLE
        if full and not isinstance(error, LabError):
            raise LabError(no_room(path.parent)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def no_room(folder: Path | str) -> str:
    """What to tell when a disk is full."""
    return f"There is no room left in {folder}: free some, or set PGDL_LAB_ROOT to a place that has some."
