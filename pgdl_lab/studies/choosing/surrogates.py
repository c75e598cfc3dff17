"""The least surrogate that keeps tolerance and time per query, once the data are chosen."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.assessment.latency import median_ms
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.doubt import trained
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.choosing.choice import Choice
from pgdl_lab.studies.choosing.settings import ChooseSettings


def add_surrogate(
    choice: Choice, experiment: Experiment, settings: ChooseSettings, say: Callable[[str], None]
) -> Choice:
    """Train models in turn until one is quick and exact enough, and note it in `choice`.

    Its largest error is known, not estimated: the simulation holds all the points that it was not trained on.
    """
    assert choice.snapshots is not None

    def explain(reason: str) -> None:
        choice.reasons.append(reason)
        say(reason)

    if settings.budget_ms is None:
        explain("surrogate: none, no time per query was asked for (budget_ms)")
        return choice
    needed = 1e3 * choice.snapshots.provenance["seconds"]
    if needed <= settings.budget_ms:
        explain(f"surrogate: none, a simulation takes {needed:.3g} ms")
        return choice
    if not choice.met:
        explain("surrogate: none was trained, as its data are not within the tolerance")
        return choice
    explain(f"surrogate: needed, a simulation takes {needed:.3g} ms")
    for points in settings.more_points:
        for name in settings.models:
            done = _trial(choice, experiment, settings, name, points, explain)
            if done:
                return choice
    choice.met = False
    if choice.model is None:
        explain(f"NOT MET: no surrogate answers within {settings.budget_ms:g} ms")
    else:
        explain(f"NOT MET: the best surrogate adds {choice.surrogate_mm:.2g} mm")
    return choice


def _trial(
    choice: Choice, experiment: Experiment, settings: ChooseSettings, name: str, more: int,
    explain: Callable[[str], None],
) -> bool:  # fmt: skip
    """Train one model on `more` times the points; whether it will do. The best that is quick enough is kept."""
    snapshots = choice.snapshots
    assert snapshots is not None and settings.budget_ms is not None
    model = plugin("model", name)()
    total = snapshots.displacements.shape[0] * snapshots.displacements.shape[1]
    split = replace(experiment.split, points=min(more * experiment.split.points, total // 2))
    train = split.train_points(snapshots, experiment.seed)
    began = time.perf_counter()
    try:
        with tempfile.TemporaryDirectory() as folder:
            quiet = replace(experiment, finger=choice.finger, trainer=replace(experiment.trainer, progress=False))
            surrogate = trained(model, quiet.training(snapshots, train, Path(folder)))
    except LabError as failure:
        explain(f"surrogate: not {name}: {failure}")
        return False
    seconds = time.perf_counter() - began
    choice.spent_s += seconds
    comparison = Comparison(
        snapshots, surrogate.predict(snapshots.domain.points_mm, snapshots.pressures_kpa, beyond=True), train
    )
    error = float(np.linalg.norm(comparison.error_mm, axis=2).max())
    query = median_ms(
        lambda: surrogate.predict(snapshots.domain.points_mm, float(snapshots.pressures_kpa[-1]), beyond=True)
    )
    late = query > settings.budget_ms
    over = settings.budget_s is not None and snapshots.provenance["seconds"] + seconds > settings.budget_s
    allowed = settings.tolerance_mm - choice.expected_mm - choice.dropped_mm
    says = f"{name} on {len(train):,} points: largest error {error:.2g} mm, {query:.2g} ms, trained in {seconds:.1f} s"
    if not late and not over and (choice.model is None or error < choice.surrogate_mm):
        choice.model, choice.split, choice.surrogate, choice.surrogate_mm = model, split, surrogate, error
    good = error <= allowed and not late and not over
    explain(f"surrogate: {'' if good else 'not '}{says}")
    return good
