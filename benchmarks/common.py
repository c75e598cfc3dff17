"""What the benchmarks share: arguments, results that are kept, tables and figures.

Every benchmark takes `--quick`: the same code on a small scene, in seconds. What such a run writes lies in
runs/quick/NAME, which is empty when it starts; docs/ and what longer runs kept are left alone.

The lab is imported in functions, as some benchmarks choose its root first, and others measure what a process takes.
"""

import argparse
import hashlib
import json
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SKIPPED = 77
"""Exit status of a benchmark that lacks what it measures, as automake has it."""
LEFT_OUT = "left out: "
"""How a line begins that says what was not measured, and what to install for it."""


def parser(doc: str | None) -> argparse.ArgumentParser:
    """Arguments of a benchmark, whose help is its docstring."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def parsed(parser: argparse.ArgumentParser, **quick: Any) -> argparse.Namespace:
    """What was typed; with `--quick` the values `quick` stand for what was not."""
    small = "".join(f"; {name}={value}" for name, value in quick.items())
    parser.add_argument("--quick", action="store_true", help=f"seconds, on small scenes, into runs/quick{small}")
    if parser.parse_args().quick:
        parser.set_defaults(**quick)
    return parser.parse_args()


def folders(name: str, quick: bool) -> tuple[Path, Path]:
    """Where a benchmark keeps its results, and where its pages and figures go: an empty folder for a quick run."""
    from pgdl_lab.core import paths

    if not quick:
        return paths.RUNS / name, Path(__file__).resolve().parents[1] / "docs"
    place = paths.RUNS / "quick" / name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    return place, place


def missing(what: str, package: str) -> None:
    """Say what was not measured, and the package that brings it."""
    print(f"{LEFT_OUT}{what}; install {package}", flush=True)


def skip(what: str, package: str) -> NoReturn:
    """End a benchmark that lacks what it measures."""
    missing(what, package)
    sys.exit(SKIPPED)


def digest(known: Any) -> str:
    """A name for what determines a result (JSON types)."""
    return hashlib.sha256(json.dumps(known, sort_keys=True, default=str).encode()).hexdigest()[:12]


def kept(path: Path, make: Callable[[], dict[str, Any]], deadline: float = math.inf) -> dict[str, Any] | None:
    """The result in `path`, made now if it is not there: a series that was broken off goes on where it was.

    Parameters
    ----------
    make
        Gives the result (JSON types).
    deadline
        Time of `time.monotonic` after which nothing more is made, and None is given.
    """
    from pgdl_lab.core.files import replacing

    if not path.is_file():
        if time.monotonic() > deadline:
            return None
        found = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(found, indent=1, default=str), encoding="utf-8")
    result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return result


def table(title: str, headings: Iterable[str], left: int = 1) -> Table:
    """An empty table, its first columns aligned `left`, the numbers behind them right."""
    made = Table(title=escape(title))  # or rich would take a unit in square brackets for a style
    for number, heading in enumerate(headings):
        made.add_column(escape(heading), justify="left" if number < left else "right")
    return made


def show(*tables: Table) -> None:
    """Print tables as wide as they are."""
    Console(width=200).print(*tables)


def spread(values: Sequence[float] | NDArray[np.float64], middle: Any = np.mean, form: str = ".3g") -> str:
    """Middle (least … greatest)."""
    return f"{middle(values):{form}} ({min(values):{form}} … {max(values):{form}})"


def print_load() -> None:
    """Print what else the machine did."""
    print(f"load of the machine in the last minute: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def panels(rows: int, columns: int, size: tuple[float, float], **shared: Any) -> tuple["Figure", Any]:
    """A figure of that size [inches] and its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **shared)


def save(figure: "Figure", path: Path, dpi: int) -> None:
    """Write a figure, whole or not at all."""
    from pgdl_lab.core.files import replacing

    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi)
    print(f"Figure: {path}")
