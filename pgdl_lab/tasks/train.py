"""Task `train`: simulate, train a surrogate, assess it, track all of it."""

from functools import partial
from pathlib import Path
from typing import Any

from pgdl_lab.learning.data import Samples
from pgdl_lab.running import pipeline
from pgdl_lab.running.tracking import tracked_run
from pgdl_lab.running.trial import ticket
from pgdl_lab.tasks import Job


def run(job: Job) -> float:
    """Run the experiment; a search minimises what is returned, the mean squared error over points to select by [mm²].

    Where the training points leave none, it is that over the test points.
    """
    pipeline.check(job.experiment)
    with tracked_run(job.folder, job.sweep_folder) as tracked:
        metrics = pipeline.run(job.experiment, job.folder, tracked, partial(pruning, job.folder))
    mse = metrics["selection_mm2"] or metrics["mse_mm2"]
    return float(sum(mse.values()))


def pruning(folder: Path, selection: Samples) -> list[Any]:
    """The Lightning callbacks by which a search watches the training in `folder`, on the points that it selects by."""
    mine = ticket(folder)
    if mine is None or mine.pruner is None:
        return []
    from pgdl_lab.search.pruning import Pruning  # loads Optuna

    return [Pruning(mine, folder, selection)]
