"""Task `simulate`: only the snapshots of the finite-element model, and the whole body for ParaView."""

import logging

from pgdl_lab import paths
from pgdl_lab.cache import simulate
from pgdl_lab.paraview import write_series
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Simulate, unless the cache holds the snapshots, write the body for ParaView and say where both are."""
    experiment = job.experiment
    folder = paths.RUNS / "snapshots"
    snapshots, path, cached = simulate(experiment.finger, experiment.fem, experiment.observation, folder)
    _log.info("Snapshots %s: %s", "were there already" if cached else "computed", path)
    if snapshots.body is not None:
        _log.info("The whole body for ParaView: %s", write_series(snapshots.body, job.folder / "paraview"))
