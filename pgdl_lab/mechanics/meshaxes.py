"""How a mesh lies: its axes turned to those of the lab, and parts of it picked by where they are."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError

Array = NDArray[np.float64]

NAMES = "xyz"
TERM = re.compile(r"([xyz])\s*(<=|>=|<|>)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")
AT = 1e-6  # of the largest side: what is so near to a limit lies on it


def rotation(axes: Sequence[str]) -> Array:
    """Signed permutation (3, 3) whose rows are the lab's x, y and z in terms of those of the file, e.g. [-x, -z, -y].

    Raises
    ------
    InputError
        When `axes` is no signed permutation of x, y and z.
    """
    rows = np.zeros((3, 3))
    for row, axis in zip(rows, axes, strict=False):
        name = axis.strip().lower().lstrip("+-")
        if name in NAMES and len(name) == 1:
            row[NAMES.index(name)] = -1 if axis.strip().startswith("-") else 1
    if len(axes) != 3 or abs(np.linalg.det(rows)) != 1:
        raise InputError(
            f"finger.axes is [{','.join(axes)}]; give the file's axes that become x (from the clamp to the tip), y "
            "(across) and z (up), each once, e.g. [-x,-z,-y]."
        )
    return rows


def named(rows: Array) -> str:
    """What to type for a signed permutation (3, 3), e.g. "[-x,-z,-y]"."""
    return f"[{','.join(('-' if row.min() < 0 else '') + NAMES[np.abs(row).argmax()] for row in rows)}]"


def is_limit(text: str) -> bool:
    """Whether `text` says where something lies, and is no name."""
    return "<" in text or ">" in text


def within(text: str, points: Array, setting: str) -> NDArray[np.bool_]:
    """Which of `points` (N, 3) [mm] lie where `text` says, e.g. "x<1 and z>=3"; `setting` is what it was given for.

    Raises
    ------
    InputError
        When `text` does not read so.
    """
    near = AT * np.ptp(points, axis=0).max()
    inside = np.ones(len(points), dtype=bool)
    for part in text.split(" and "):
        term = TERM.fullmatch(part.strip())
        if term is None:
            raise InputError(
                f"{setting} is '{text}', of which '{part.strip()}' says no place: write x, y or z, then <, <=, > or "
                ">=, then a number in mm, and join several by 'and', e.g. 'x<1 and z>3'."
            )
        value, limit = points[:, NAMES.index(term[1])], float(term[3])
        below, above = limit - value, value - limit
        inside &= {"<": below > near, "<=": below >= -near, ">": above > near, ">=": above >= -near}[term[2]]
    return inside
