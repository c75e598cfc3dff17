"""The default model on fingers that nobody looked at when its structure was chosen, both splits.

    python benchmarks/unseen_fingers.py [seconds]

Three altered fingers and nothing else changed; a dozen minutes on one core. Each training is stored under
runs/unseen_fingers as soon as it ends, and a later call goes on where one of at most `seconds` stopped. Errors are
medians over the seeds, with the worst seed in brackets: mean squares over all points that were not trained on and, for
`extrapolate`, at the worst of the pressures that the split highlights. `in bar` is the least share of errors within the
95 % error bar, over the whole and over those pressures.
"""

import hashlib
import itertools
import json
import math
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.core import paths, registry
from pgdl_lab.core.files import replacing
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.scene import Scene
from pgdl_lab.running import cache
from pgdl_lab.running.composing import experiment
from pgdl_lab.running.experiment import Experiment

FINGERS = {
    "pneunet, 6 chambers, walls of 2.2 mm": ["finger=pneunet", "finger.chambers=6", "finger.wall_mm=2.2"],
    "joints, 2 of 4 chambers, phalanx of 25 mm": [
        "finger=joints", "finger.joints=2", "finger.chambers=4", "finger.phalanx_mm=25",
    ],
    "bellows, hanging: gravity along x": ["finger=bellows", "finger.gravity_m_s2=[9.81,0.0]"],
}  # fmt: skip
SPLITS, SEEDS = ("random", "extrapolate"), (0, 1, 2)


def train(trial: Experiment) -> dict[str, Any]:
    """Errors and coverage of one training."""
    folder = paths.RUNS / "snapshots"
    snapshots, *_ = cache.simulate(trial.finger, trial.fem, trial.observation, folder)
    points = trial.split.train_points(snapshots, trial.seed)
    scene = Scene.of(trial.finger, snapshots)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as place:
        surrogate = trial.model.fit(
            Training.of(
                Samples.of(snapshots, points), scene, trial.loss, trial.trainer, trial.optimizer, trial.seed,
                Path(place), {},
            )
        )  # fmt: skip
    seconds = time.perf_counter() - start
    where = snapshots.domain.points_mm, snapshots.pressures_kpa
    found = Comparison(snapshots, surrogate.predict(*where), points, surrogate.error_bar(*where))
    rows = found.by_pressure()
    shown = [rows[i] for i in trial.split.highlights(snapshots.pressures_kpa)]
    bars = found.error_bar()
    return {
        "seconds": seconds,
        "x": found.mse_mm2()["x"],
        "z": found.mse_mm2()["z"],
        "beyond_x": max(row["mse_x_mm2"] for row in shown),
        "beyond_z": max(row["mse_z_mm2"] for row in shown),
        "covered": min(bars["covered_x"], bars["covered_z"]) if bars else math.nan,
        "beyond_covered": min(row["covered"] for row in shown) if bars else math.nan,
    }


def result(choices: list[str], deadline: float) -> dict[str, Any] | None:
    """What `train` finds, from the disk if it was found before; None after the deadline."""
    trial = experiment([*choices, "fem.estimate_error=false", "trainer.progress=false"])
    parts = [registry.describe(part) for part in (trial.finger, trial.fem, trial.split, trial.model)]
    digest = hashlib.sha256(json.dumps([*parts, trial.seed], sort_keys=True).encode()).hexdigest()[:12]
    path = paths.RUNS / "unseen_fingers" / f"{digest}.json"
    if not path.exists():
        if time.monotonic() > deadline:
            return None
        path.parent.mkdir(parents=True, exist_ok=True)
        found = train(trial)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps({"choices": choices, **found}))
    return json.loads(path.read_text())


def cell(results: list[dict[str, Any]], key: str) -> str:
    """Median and worst."""
    values = [row[key] for row in results]
    worst = min(values) if "covered" in key else max(values)
    form = ".0%" if "covered" in key else ".1e"
    return f"{median(values):{form}} ({worst:{form}})"


def main() -> None:
    """Train what is missing and print the table."""
    deadline = time.monotonic() + (float(sys.argv[1]) if len(sys.argv) > 1 else math.inf)
    registry.discover()
    table = Table(title="MSE [mm²], median (worst) over seeds, of the default model")
    keys = ("x", "z", "covered", "beyond_x", "beyond_z", "beyond_covered")
    headings = ("MSE x", "MSE z", "in bar", "highlights x", "highlights z", "in bar there")
    for heading in ("finger", "split", "seeds", *headings, "seconds"):
        table.add_column(heading, justify="left" if heading in ("finger", "split") else "right")
    for (name, choices), split in itertools.product(FINGERS.items(), SPLITS):
        tried = [result([*choices, f"split={split}", f"seed={seed}"], deadline) for seed in SEEDS]
        results = [row for row in tried if row is not None]
        if results:
            seconds = f"{median(row['seconds'] for row in results):.0f}"
            table.add_row(name, split, str(len(results)), *(cell(results, key) for key in keys), seconds)
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
