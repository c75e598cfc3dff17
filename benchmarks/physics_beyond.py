"""What terms of physics gain beyond the trained pressures by being visited there, where there are no data.

    PYTHONPATH=. python benchmarks/physics_beyond.py [seconds]

The trainings of `physics_ablation.py` on split extrapolate, up to 44 kPa, each term with pressures drawn up to 44 kPa
("trained") and up to 50 kPa ("of interest", what a training does). Results are appended to a file under runs/, where a
later call goes on, for at most `seconds` (default: until all are done); then the table is printed.
"""

import itertools
import json
import math
import sys
import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.physics_ablation import CHAMBERS, STEPS, TERMS, WORTHS_MM, Case, setting, train
from pgdl_lab.core import paths
from pgdl_lab.learning import left_out

SEEDS, SHARES = range(3), (0.01, 0.002)
REACHES = {"trained": 44.0, "of interest": 50.0}  # [kPa]


@dataclass(frozen=True)
class Reached:
    """A training and the pressures that its terms of physics are visited at."""

    case: Case
    reach: str


def trials() -> list[Reached]:
    """All trainings, seed by seed, so that a broken-off series has as many of each."""
    found = []
    for seed, share in itertools.product(SEEDS, SHARES):
        found.append(Reached(Case(seed, "extrapolate", share, "none", 0.0), "trained"))
        for term, worth, reach in itertools.product(TERMS, WORTHS_MM, REACHES):
            found.append(Reached(Case(seed, "extrapolate", share, term, worth), reach))
    return found


def compared(results: dict[Reached, dict[str, Any]], share: float, term: str, worth: float, error: str) -> list[str]:
    """Error with a term by that of data alone for each reach: geometric mean, least and greatest over the seeds."""
    cells = []
    for reach in REACHES:
        ratios = []
        for seed in SEEDS:
            ours = results.get(Reached(Case(seed, "extrapolate", share, term, worth), reach))
            alone = results.get(Reached(Case(seed, "extrapolate", share, "none", 0.0), "trained"))
            if ours and alone and not ours["failed"] and not alone["failed"]:
                ratios.append(ours[error] / alone[error])
        mean = math.exp(np.mean(np.log(ratios))) if ratios else math.nan
        cells.append(f"{mean:.2f} ({min(ratios):.2f} … {max(ratios):.2f})" if ratios else "–")
    return cells


def main() -> None:
    """Train what is missing and print."""
    left_out.FEW = 0  # error bars of few points take five trainings more, and nobody asks for them here
    deadline = time.monotonic() + (float(sys.argv[1]) if len(sys.argv) > 1 else math.inf)
    snapshots, scene, found = setting()
    floors = {term: values["fem"] for term, values in found.items()}
    path = paths.RUNS / f"physics_beyond_{CHAMBERS}_{STEPS}.jsonl"
    results: dict[Reached, dict[str, Any]] = {}
    for line in path.read_text().splitlines() if path.exists() else []:
        row = json.loads(line)
        results[Reached(Case(**row["case"]), row["reach"])] = row["result"]
    with path.open("a") as file:
        for trial in trials():
            if trial in results or time.monotonic() > deadline:
                continue
            reaching = replace(scene, max_kpa=REACHES[trial.reach])
            results[trial] = train(trial.case, snapshots, reaching, floors)
            file.write(json.dumps({**asdict(trial), "result": results[trial]}) + "\n")
            file.flush()
    table = Table(title="RMS error by that of data alone: geometric mean (least … greatest) over seeds")
    headings = [f"{where}, physics up to {kpa:g} kPa" for where in ("above 44", "up to 44") for kpa in REACHES.values()]
    for heading in ("points", "term", "worth [mm]", *headings):
        table.add_column(heading, justify="right")
    for share, term, worth in itertools.product(SHARES, TERMS, WORTHS_MM):
        cells = [cell for error in ("beyond_mm", "within_mm") for cell in compared(results, share, term, worth, error)]
        table.add_row(f"{share:.1%}", term, f"{worth:g}", *cells)
    Console(width=160).print(table)
    failed = sum(result["failed"] for result in results.values())
    print(f"{len(results)} trainings, {failed} failed")


if __name__ == "__main__":
    main()
