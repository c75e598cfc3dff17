"""The program CalculiX itself: where it is and which version."""

import re
import shutil
import subprocess

from pgdl_lab.core.errors import InputError

PROGRAM = "ccx"


def program() -> str:
    """Path of the program.

    Raises
    ------
    InputError
        When it is not installed.
    """
    path = shutil.which(PROGRAM)
    if path is None:
        raise InputError(
            f"fem=calculix needs the program '{PROGRAM}', which is not on the PATH: install CalculiX (on Debian and "
            "Ubuntu: sudo apt-get install calculix-ccx) or choose fem=solid."
        )
    return path


def version() -> str:
    """Version that the program tells of itself; raises InputError when it is not installed."""
    told = subprocess.run([program(), "-v"], capture_output=True, text=True, check=False).stdout
    found = re.search(r"Version (\S+)", told)
    return found[1] if found else "unknown"
