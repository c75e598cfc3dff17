"""What guide and network add to `pod`: errors from few and many points, within the trained pressures and beyond.

    python benchmarks/few_points.py [finger ...] [--points 40 400 20000] [--models pod body] [--seeds 1 2 3]

Fingers are simulated as usual. `pod` is fitted to the displacement, `guided` to what the rod leaves of it, and `hybrid`
is the default model: rod, network and closed form. "within" is the root mean square error over all points that were not
trained on, drawn from all pressures; "beyond" that at the highest pressure of trainings that end at 88 % of it. Results
are kept in runs/few_points and the table is made of what is there; medians over the seeds, and the range. Settings were
chosen on seed 0.
"""

import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import common, scenes
from pgdl_lab.core import sources
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.registry import describe, plugin
from pgdl_lab.learning.data import Training
from pgdl_lab.running import cache
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.surrogate import Surrogate

GUIDED = "guided"
MODELS = ("pod", GUIDED, "hybrid")
BELOW = 0.88  # of the highest pressure: 44 of 50 kPa


def main() -> None:
    """Measure what is missing and print the table."""
    arguments = common.parser(__doc__)
    arguments.add_argument("fingers", nargs="*", default=scenes.FINGERS)
    arguments.add_argument("--points", type=int, nargs="*", default=[40, 400, 20_000])
    arguments.add_argument("--models", nargs="*", default=MODELS, help="others too, such as body")
    arguments.add_argument("--seeds", type=int, nargs="*", default=[1, 2, 3])
    given = common.parsed(arguments, fingers=scenes.FINGERS[:1], points=[40, 400], seeds=[1])
    warnings.simplefilter("ignore")  # of pressures outside, which are asked for here
    store, _ = common.folders("few_points", given.quick)
    shown = common.table(
        "Root mean square error [mm]: median of the seeds (least … greatest)",
        ("finger", "points", "model", "within", "in bar", "beyond", "in bar", "trained in"),
    )
    for finger in given.fingers:
        trial = scenes.scene(finger, quick=given.quick)
        snapshots = scenes.simulated(trial)
        for points in given.points:
            for model in given.models:
                found = [_result(trial, snapshots, store, model, points, seed) for seed in given.seeds]
                shown.add_row(finger, f"{points:,}", model, *(_told(found, name) for name in found[0]))
        shown.add_section()
    common.show(shown)


def _told(found: list[dict[str, float]], name: str) -> str:
    values = np.array([each[name] for each in found])
    if name.startswith("in bar"):
        return f"{np.median(values):.0%}"
    if name == "seconds":
        return f"{np.median(values):.1f} s"
    return f"{np.median(values):.2g} ({values.min():.2g} … {values.max():.2g})"


def _result(trial: Experiment, snapshots: Dataset, store: Path, model: str, points: int, seed: int) -> dict[str, float]:
    """The measurement of one training within and one beyond, from the store or made now."""
    known = cache.snapshot_path(Path(), trial.finger, trial.fem, trial.observation).name
    code = sources.digest([plugin("model", "hybrid" if model == GUIDED else model)])

    def measure() -> dict[str, float]:
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
        print(describe(trial.finger)["name"], points, model, seed, result, flush=True)
        return result

    found = common.kept(store / f"{common.digest([known, code, model, points, seed])}.json", measure)
    assert found is not None
    return found


def _trained(
    trial: Experiment, snapshots: Dataset, model: str, points: int, seed: int, below: float
) -> tuple[Surrogate, Any]:
    """A surrogate, and which points (P, N) it was trained on."""
    pressures = snapshots.pressures_kpa
    among = int((pressures <= below * pressures[-1] * (1 + 1e-9)).sum()) * len(snapshots.domain.points_mm)
    train = np.sort(np.random.default_rng(seed).choice(among, points, replace=False))
    chosen: Any = Guided() if model == GUIDED else plugin("model", model)()
    made = replace(trial, model=chosen, seed=seed)
    return scenes.fitted(made, snapshots, train)[0], ~scenes.unseen_of(snapshots, train)


class Guided:
    """Model `hybrid` whose network adds nothing yet."""

    def fit(self, training: Training) -> Surrogate:
        """What the closed form makes of the displacement that the rod leaves."""
        hybrid: Any = plugin("model", "hybrid")()
        field, _ = hybrid.begin(training)
        return hybrid.finished(
            field, Record(training.samples.ranges(), {}, domain=training.scene.kept_domain), training
        )


if __name__ == "__main__":
    main()
