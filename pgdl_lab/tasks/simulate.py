"""Task `simulate`: only the snapshots of the finite-element model."""

import logging

from pgdl_lab import paths
from pgdl_lab.cache import simulate
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Simulate, unless the cache holds the snapshots, and say where they are."""
    experiment = job.experiment
    _, path, cached = simulate(experiment.finger, experiment.fem, experiment.observation, paths.RUNS / "snapshots")
    _log.info("Snapshots %s: %s", "were there already" if cached else "computed", path)
