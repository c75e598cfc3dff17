"""The way of the data: simulate, split, fit, assess. Read this file first."""

import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from pgdl_lab.assessment import yardstick as yardsticks
from pgdl_lab.assessment.assess import Labels, assess
from pgdl_lab.assessment.paper import Published, comparable
from pgdl_lab.assessment.table import closing_table
from pgdl_lab.core import paths
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.heard import ASIDE
from pgdl_lab.core.observation import BODY, FACE
from pgdl_lab.core.registry import describe
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.doubt import trained
from pgdl_lab.learning.in_space import require_in_plane, require_in_space
from pgdl_lab.learning.module import TrainingDiverged
from pgdl_lab.running.cache import simulate
from pgdl_lab.running.epoch_logger import EpochLogger
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.running.tracking import TrackedRun
from pgdl_lab.surrogate.surrogate import ERROR

_log = logging.getLogger(__name__)


def check(experiment: Experiment) -> None:
    """Refuse what cannot be trained; raises InputError."""
    observation, split = experiment.observation, experiment.split
    nodes = observation.points
    if observation.of == BODY:
        require_in_space(experiment.model, experiment.loss)
        nodes = split.points + 1  # the mesh is not made yet: whether it has so many is asked again
    else:
        require_in_plane(experiment.loss)
    split.check(observation.cases(experiment.finger.max_kpa), nodes)
    for loss in experiment.loss.values():
        loss.check(experiment.finger)


def run(
    experiment: Experiment,
    folder: Path,
    tracked: TrackedRun,
    watching: Callable[[Samples], Sequence[Any]] = lambda _: (),
) -> dict[str, Any]:
    """Train and assess one surrogate; everything is written to `folder`.

    Parameters
    ----------
    experiment
        What is simulated and trained.
    folder
        Run folder.
    tracked
        Where the dataset and the metrics of the epochs are logged.
    watching
        Gives Lightning callbacks that watch the training, by the points that a search selects by.

    Returns
    -------
    The content of metrics.json.

    Raises
    ------
    LabError
        If the simulation stops or the training diverges.
    """
    finger, observation, seed = experiment.finger, experiment.observation, experiment.seed
    left_out = experiment.model.left_out(experiment.loss)

    start = time.perf_counter()
    snapshots, path, cached = simulate(finger, experiment.fem, observation, paths.RUNS / "snapshots")
    waited = time.perf_counter() - start
    seconds = {
        "simulate": snapshots.provenance.get("seconds", waited),
        "simulate_cached": waited if cached else 0.0,
    }
    _log.info("Snapshots %s: %s", "from the cache" if cached else "computed", path)
    tracked.log_snapshots(snapshots, path)

    train = experiment.split.train_points(snapshots, seed)
    selection = experiment.split.selection_points(snapshots, train, seed)

    start = time.perf_counter()
    callbacks = watching(Samples.of(snapshots, selection))
    training = experiment.training(snapshots, train, folder, logger=EpochLogger(tracked), callbacks=callbacks)
    try:
        surrogate = trained(experiment.model, training)
    except TrainingDiverged as diverged:
        earlier = (folder / "surrogate.pt").exists()  # of a training that ended well before it was resumed
        diverged.surrogate.save(folder / ("surrogate_diverged.pt" if earlier else "surrogate.pt"))
        raise
    surrogate.save(folder / "surrogate.pt")
    seconds["train"] = time.perf_counter() - start
    beside = experiment.yardstick
    yardstick = yardsticks.measure(beside, training, snapshots, train, selection) if beside else None

    labels = Labels(
        finger=describe(finger)["name"],
        fem=describe(experiment.fem)["name"],
        split=describe(experiment.split)["name"],
        model=describe(experiment.model)["name"],
        losses=list(experiment.loss),
        left_out=left_out,
        seed=seed,
    )
    parts = train, selection, experiment.split
    assessment = assess(surrogate, snapshots, *parts, labels, seconds, folder, training, yardstick)
    surrogate.record.provenance[ERROR] = assessment.metrics["surrogate_error"]
    try:
        surrogate.save(folder / "surrogate.pt")
    except LabError as problem:  # the one saved before lacks this number alone
        _log.warning("surrogate.pt does not tell its own error: %s", problem, extra=ASIDE)
    paper = comparable(finger, experiment.split) if observation.of == FACE else Published()
    Console().print(closing_table(assessment.metrics, assessment.highlights, paper))
    _log.info("Everything of this run is in %s", folder)
    return assessment.metrics
