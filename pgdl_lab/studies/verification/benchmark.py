"""What a benchmark is, the list of all, and how they are run."""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Check:
    """One figure of a benchmark beside its reference; a check that 0 would pass, whatever is right, is none.

    A figure whose reference is 0 is therefore to be relative to one that is not, without a unit.

    Attributes
    ----------
    name
        What is compared, with its unit.
    reference, obtained
        What is known and what was computed.
    tolerance
        Largest accepted difference of the two, in their unit.
    source
        Where the reference is from.

    Raises
    ------
    ValueError
        When the tolerance reaches from the reference to 0, or the reference is 0 and the figure has a unit.
    """

    name: str
    reference: float
    obtained: float
    tolerance: float
    source: str

    def __post_init__(self) -> None:
        if self.reference == 0 and not self.name.endswith("[–]"):
            raise ValueError(f"'{self.name}' is compared with 0: make it relative to something that is not 0.")
        if self.tolerance >= (abs(self.reference) or 1.0):
            raise ValueError(f"'{self.name}' has the tolerance {self.tolerance:g}, with which 0 would pass.")

    @property
    def passed(self) -> bool:
        """Whether the difference is within the tolerance; not a number never is."""
        return bool(abs(self.obtained - self.reference) <= self.tolerance)  # also of NumPy's numbers, for the JSON file


@dataclass(frozen=True)
class Row:
    """A check, or the failure of a benchmark, with the time it took.

    Attributes
    ----------
    benchmark
        Name of the benchmark.
    check
        What came out; None when the benchmark failed.
    problem
        Why it failed; empty otherwise.
    seconds
        Time since the check before [s].
    """

    benchmark: str
    check: Check | None
    problem: str
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether the check was made and passed."""
        return self.check is not None and self.check.passed


Function = Callable[[bool], Iterator[Check]]


@dataclass(frozen=True)
class Benchmark:
    """A function that computes checks; it is told whether to be quick.

    Attributes
    ----------
    name
        Shown in the table.
    function
        Yields the checks.
    quick
        Whether it belongs to the quick variant.
    """

    name: str
    function: Function
    quick: bool


BENCHMARKS: list[Benchmark] = []


def benchmark(name: str, *, quick: bool) -> Callable[[Function], Function]:
    """Register the decorated function under `name`; `quick`: as part of the quick variant too."""

    def register(function: Function) -> Function:
        BENCHMARKS.append(Benchmark(name, function, quick))
        return function

    return register


def run(benchmarks: list[Benchmark], quick: bool) -> Iterator[Row]:
    """Make the checks of all `benchmarks`; one that fails gives a row that says why, and the others go on."""
    for each in benchmarks:
        began = time.perf_counter()
        try:
            for check in each.function(quick):
                yield Row(each.name, check, "", time.perf_counter() - began)
                began = time.perf_counter()
        except Exception as error:  # whatever it is, it is a row of the table
            _log.debug("%s", each.name, exc_info=True)
            yield Row(each.name, None, f"{type(error).__name__}: {error}", time.perf_counter() - began)
