"""How a trial ended, counted by method and axis.

The thresholds below were set before any trial was looked at.
"""

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pgdl_lab.errors import InputError, LabError
from pgdl_lab.heard import heard
from pgdl_lab.messages import sentence
from pgdl_lab.surrogate import Outside

GOOD = 0.05
"""Largest error of a success: of the largest displacement (finite elements), of its root mean square (learning)."""
STALLED = 0.5
"""A learnt model that errs more than this has learnt next to nothing."""
MODES = ("ok", "wrong", "stalled", "refused", "stopped", "not a number", "crashed")
"""With a sentence `refused` ended before it began and `stopped` on the way; `crashed` is an error nobody expected."""


@dataclass(frozen=True)
class Trial:
    """One method under one stress.

    Attributes
    ----------
    part
        "mechanics" or "learning".
    axis, level
        The stress and how hard it was.
    method
        What was tried.
    mode
        One of `MODES`.
    error
        Relative error; None where there is no result.
    told
        The warning or sentence that came with it; empty: nothing was said.
    seconds
        How long it took [s].
    """

    part: str
    axis: str
    level: str
    method: str
    mode: str
    error: float | None
    told: str
    seconds: float

    @property
    def silent(self) -> bool:
        """Whether it gave a wrong result without a word: the worst of all outcomes."""
        return self.mode in ("wrong", "stalled", "not a number") and not self.told


@dataclass(frozen=True)
class Result:
    """What a trial returned: its relative error, and what the method itself said of it in numbers."""

    error: float
    told: str = ""


def tried(part: str, axis: str, level: str, method: str, attempt: Callable[[], Result]) -> Trial:
    """Make an attempt, whatever comes of it."""
    began = time.perf_counter()
    try:
        with heard() as sentences, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore")  # of libraries: not written for the user of the lab
            warnings.simplefilter("always", Outside)
            result = attempt()
        told = result.told or "; ".join([*sentences, *(str(warning.message) for warning in caught)])
        mode, error = _mode(part, result.error), result.error if math.isfinite(result.error) else None
    except LabError as problem:
        mode, error, told = "refused" if isinstance(problem, InputError) else "stopped", None, sentence(problem)
    except Exception as problem:  # the very thing that is looked for
        mode, error, told = "crashed", None, f"{type(problem).__name__}: {problem}"
    return Trial(part, axis, level, method, mode, error, told, time.perf_counter() - began)


def _mode(part: str, error: float) -> str:
    if not math.isfinite(error):
        return "not a number"
    if error <= GOOD:
        return "ok"
    return "stalled" if part == "learning" and error > STALLED else "wrong"


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Confidence interval of a success rate, of 95 % for the given z (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if trials == 0:
        return 0.0, 1.0
    rate, spread = successes / trials, z**2 / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = z / (1 + spread) * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials))
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True)
class Cell:
    """All trials of one method along one axis."""

    trials: Sequence[Trial]

    @property
    def ok(self) -> int:
        """Number of successes."""
        return sum(trial.mode == "ok" for trial in self.trials)

    @property
    def silent(self) -> int:
        """Number of silent failures."""
        return sum(trial.silent for trial in self.trials)

    def record(self) -> dict[str, Any]:
        """For the map: counts by mode, the rate with its interval, the median error of the successes."""
        errors = sorted(trial.error for trial in self.trials if trial.mode == "ok" and trial.error is not None)
        first = self.trials[0]
        low, high = wilson(self.ok, len(self.trials))
        return {
            "part": first.part, "method": first.method, "axis": first.axis, "trials": len(self.trials),
            "success_rate": self.ok / len(self.trials), "from": low, "to": high,
            "median_error": errors[len(errors) // 2] if errors else None, "silently_wrong": self.silent,
            **{mode: sum(trial.mode == mode for trial in self.trials) for mode in MODES},
        }  # fmt: skip


def cells(trials: Sequence[Trial]) -> dict[tuple[str, str], Cell]:
    """Cells by method and axis, in the order of the trials."""
    found: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        found.setdefault((trial.method, trial.axis), []).append(trial)
    return {key: Cell(group) for key, group in found.items()}
