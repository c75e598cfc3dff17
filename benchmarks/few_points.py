"""What guide and network add to `pod`: errors from few and many points, within the trained pressures and beyond.

    python benchmarks/few_points.py [finger ...] [--points 40 400 20000] [--models pod body] [--seeds 1 2 3]

Fingers are simulated as usual. `pod` is fitted to the displacement, `guided` to what the rod leaves of it, and `hybrid`
is the default model: rod, network and closed form. "within" is the root mean square error over all points that were not
trained on, drawn from all pressures; "beyond" that at the highest pressure of trainings that end at 88 % of it. Results
are kept in runs/few_points and the table is made of what is there; medians over the seeds, and the range. Settings were
chosen on seed 0.
"""

import argparse
import hashlib
import json
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from pgdl_lab.core import paths
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.files import replacing
from pgdl_lab.core.registry import describe, plugin
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.scene import Scene
from pgdl_lab.running import cache
from pgdl_lab.running.composing import experiment
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.surrogate import Surrogate

FINGERS, MODELS = ("pneunet", "joints", "bellows"), ("pod", "guided", "hybrid")
BELOW = 0.88  # of the highest pressure: 44 of 50 kPa


def main() -> None:
    """Measure what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fingers", nargs="*", default=FINGERS)
    parser.add_argument("--points", type=int, nargs="*", default=[40, 400, 20_000])
    parser.add_argument("--models", nargs="*", default=MODELS, help="others too, such as body")
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2, 3])
    given = parser.parse_args()
    warnings.simplefilter("ignore")  # of pressures outside, which are asked for here
    table = Table(title="Root mean square error [mm]: median of the seeds (least … greatest)")
    for heading in ("finger", "points", "model", "within", "in bar", "beyond", "in bar", "trained in"):
        table.add_column(heading, justify="left" if heading in ("finger", "model") else "right")
    for finger in given.fingers:
        trial = experiment([f"finger={finger}"])
        snapshots, path, _ = cache.simulate(trial.finger, trial.fem, trial.observation, paths.RUNS / "snapshots")
        for points in given.points:
            for model in given.models:
                found = [_result(trial, snapshots, path, model, points, seed) for seed in given.seeds]
                table.add_row(finger, f"{points:,}", model, *(_told(found, name) for name in found[0]))
        table.add_section()
    Console(width=140).print(table)


def _told(found: list[dict[str, float]], name: str) -> str:
    values = np.array([each[name] for each in found])
    if name.startswith("in bar"):
        return f"{np.median(values):.0%}"
    if name == "seconds":
        return f"{np.median(values):.1f} s"
    return f"{np.median(values):.2g} ({values.min():.2g} … {values.max():.2g})"


def _result(trial: Experiment, snapshots: Dataset, path: Path, model: str, points: int, seed: int) -> dict[str, float]:
    """The measurement of one training within and one beyond, from the store or made now."""
    package = Path(cache.__file__).parent
    code = sorted([*(package / "learning").glob("*.py"), *(package.parent / "plugins" / "model").glob("*.py")])
    digest = hashlib.sha256(b"".join(each.read_bytes() for each in code))
    digest.update(json.dumps([path.name, model, points, seed]).encode())
    kept = paths.RUNS / "few_points" / f"{digest.hexdigest()[:20]}.json"
    if not kept.is_file():
        result: dict[str, float] = {}
        began = time.perf_counter()
        for where, below in (("within", 1.0), ("beyond", BELOW)):
            surrogate, seen = _trained(trial, snapshots, model, points, seed, below)
            error = np.abs(
                surrogate.predict(snapshots.domain.points_mm, snapshots.pressures_kpa) - snapshots.displacements
            )
            bars = surrogate.error_bar(snapshots.domain.points_mm, snapshots.pressures_kpa)
            judged = ~seen
            judged[: -1 if where == "beyond" else None] &= where == "within"
            assert bars is not None
            result[where] = float(np.sqrt((error[judged] ** 2).mean()))
            result[f"in bar {where}"] = float((error <= bars[..., None])[judged].mean())
        result["seconds"] = (time.perf_counter() - began) / 2
        kept.parent.mkdir(parents=True, exist_ok=True)
        with replacing(kept) as temporary:
            temporary.write_text(json.dumps(result))
        print(describe(trial.finger)["name"], points, model, seed, result, flush=True)
    found: dict[str, float] = json.loads(kept.read_text())
    return found


def _trained(
    trial: Experiment, snapshots: Dataset, model: str, points: int, seed: int, below: float
) -> tuple[Surrogate, Any]:
    """A surrogate, and which points (P, N) it was trained on."""
    pressures = snapshots.pressures_kpa
    among = int((pressures <= below * pressures[-1] * (1 + 1e-9)).sum()) * len(snapshots.domain.points_mm)
    train = np.sort(np.random.default_rng(seed).choice(among, points, replace=False))
    seen = np.zeros(snapshots.displacements.shape[:2], dtype=bool)
    seen.ravel()[train] = True
    with tempfile.TemporaryDirectory() as folder:
        training = Training.of(
            Samples.of(snapshots, train), Scene.of(trial.finger, snapshots), trial.loss,
            replace(trial.trainer, progress=False), trial.optimizer, seed, Path(folder), {},
        )  # fmt: skip
        if model != "guided":
            return plugin("model", model)().fit(training), seen
        hybrid: Any = plugin("model", "hybrid")()
        field, _ = hybrid.begin(training)  # its network adds nothing yet
        record = Record(training.samples.ranges(), {}, domain=training.scene.kept_domain)
        return hybrid.finished(field, record, training), seen


if __name__ == "__main__":
    main()
