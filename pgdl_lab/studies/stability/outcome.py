"""How a trial ended: its error, what is truly wrong with it, what it said, and whether the numbers it stated hold.

The thresholds below were set before any trial was looked at.
"""

import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.heard import heard
from pgdl_lab.running.messages import sentence
from pgdl_lab.surrogate.limits import Outside

GOOD = 0.05
"""Largest error of a success: of the largest displacement (finite elements), of its root mean square (learning)."""
STALLED = 0.5
"""A learnt model that errs more than this has learnt next to nothing."""
WIDE = 2.0
"""The true error may be so many times as large as a stated change from one mesh to the next: that is at least half the
error where errors shrink with the edge or faster. A warning of a change so many times too large is a false alarm."""
COVERED = 0.9
"""Least share of the errors within bars that promise 95 %: those of one field rise and fall together."""
MODES = ("ok", "wrong", "stalled", "refused", "stopped", "not a number", "crashed")
"""With a sentence `refused` ended before it began and `stopped` on the way; `crashed` is an error nobody expected."""

UNSTABLE, CONTACT, ACCURACY, TRAINING, DATA, RANGE = "unstable", "contact", "accuracy", "training", "data", "range"
CAUSES = {
    UNSTABLE: "the body gives way",
    CONTACT: "surfaces pass through each other",
    ACCURACY: "mesh or model are too coarse",
    TRAINING: "the training points were not learnt",
    DATA: "too few or too noisy points",
    RANGE: "asked beyond the trained pressures",
}
"""What can truly be wrong with a result, in words."""


@dataclass(frozen=True)
class Bar:
    """A number by which a method says how far it may be off, and the truth.

    Attributes
    ----------
    what
        "mesh" (the change on a mesh with half the edges) or "95 %" (the error bar of a surrogate).
    holds
        Whether the errors are what it says.
    coverage
        Share of the errors that lie within it.
    ratio
        What it must be multiplied by to be right: the true error of a mesh over the stated one; the factor with which
        error bars cover 95 % of the errors.
    worst
        Largest error over its bar.
    """

    what: str
    holds: bool
    coverage: float
    ratio: float
    worst: float


@dataclass(frozen=True)
class Result:
    """What a trial returned, measured against the truth.

    Attributes
    ----------
    error
        Relative error.
    causes
        What is truly wrong, of `CAUSES`, as far as it was measured.
    bars
        The numbers that the method stated.
    partly
        What is wrong with a part of the result, which as a whole may be right.
    """

    error: float
    causes: tuple[str, ...] = ()
    bars: tuple[Bar, ...] = ()
    partly: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trial:
    """One method under one stress.

    Attributes
    ----------
    part
        "mechanics" or "learning".
    axis, level
        The stress and how hard it was.
    method, seed
        What was tried.
    mode
        One of `MODES`.
    error
        Relative error; None where there is no result.
    causes, bars, partly
        See `Result`.
    told
        What it warned of; where there is no result, the sentence that it ended with.
    seconds
        How long it took, without finding the truth [s].
    """

    part: str
    axis: str
    level: str
    method: str
    seed: int
    mode: str
    error: float | None
    causes: tuple[str, ...]
    bars: tuple[Bar, ...]
    partly: tuple[str, ...]
    told: tuple[str, ...]
    seconds: float

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> "Trial":
        """From what `dataclasses.asdict` made of one, by way of JSON."""
        bars = tuple(Bar(**bar) for bar in record["bars"])
        texts = {name: tuple(record[name]) for name in ("causes", "partly", "told")}
        return cls(**{**record, **texts, "bars": bars})


class Heard:
    """What the lab warns of while it is entered.

    Attributes
    ----------
    seconds
        How long that took [s].
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._logged: list[str] = []
        self._caught: list[warnings.WarningMessage] = []

    def __enter__(self) -> "Heard":
        self._began, self._open = time.perf_counter(), ExitStack()
        self._logged = self._open.enter_context(heard())
        caught = self._open.enter_context(warnings.catch_warnings(record=True))
        self._caught = [] if caught is None else caught
        warnings.simplefilter("ignore")  # of libraries: not written for the user of the lab
        warnings.simplefilter("always", Outside)
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()
        self.seconds = time.perf_counter() - self._began

    @property
    def sentences(self) -> tuple[str, ...]:
        """Each warning once."""
        return tuple(dict.fromkeys([*self._logged, *(str(each.message) for each in self._caught)]))


Attempt = Callable[[Heard], Result]
"""Enters what hears the warnings for as long as the method works, and leaves it before the truth is looked for."""


def tried(part: str, axis: str, level: str, method: str, attempt: Attempt, seed: int = 0) -> Trial:
    """Make an attempt, whatever comes of it."""
    hearing, result = Heard(), Result(math.nan)
    told: tuple[str, ...]
    try:
        result = attempt(hearing)
        mode, told = _mode(part, result.error), hearing.sentences
    except LabError as problem:
        mode, told = "refused" if isinstance(problem, InputError) else "stopped", (sentence(problem),)
    except Exception as problem:  # the very thing that is looked for
        mode, told = "crashed", (f"{type(problem).__name__}: {problem}",)
    error = result.error if math.isfinite(result.error) else None
    found = result.causes, result.bars, result.partly
    return Trial(part, axis, level, method, seed, mode, error, *found, told, hearing.seconds)


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


def cells(trials: Sequence[Trial]) -> dict[tuple[str, str], list[Trial]]:
    """Trials by method and axis, in their order."""
    found: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        found.setdefault((trial.method, trial.axis), []).append(trial)
    return found
