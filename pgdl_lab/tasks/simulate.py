"""Task `simulate`: only the snapshots of the finite-element model, and the whole body for ParaView."""

import json
import logging
import time

from pgdl_lab import paths
from pgdl_lab.cache import simulate
from pgdl_lab.files import replacing
from pgdl_lab.paraview import write_series
from pgdl_lab.registry import describe
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Simulate, unless the cache holds the snapshots, write the body for ParaView and say where both are."""
    experiment = job.experiment
    folder = paths.RUNS / "snapshots"
    start = time.perf_counter()
    snapshots, path, cached = simulate(experiment.finger, experiment.fem, experiment.observation, folder)
    _log.info("Snapshots %s: %s", "were there already" if cached else "computed", path)
    last = snapshots.displacements[-1]
    metrics = {
        "finger": describe(experiment.finger)["name"],
        "fem": describe(experiment.fem)["name"],
        "points": snapshots.displacements.shape[0] * snapshots.displacements.shape[1],
        "seconds": {"simulate": snapshots.provenance.get("seconds", time.perf_counter() - start)},
        "extremes_mm": {
            "fem": {axis: [float(last[:, i].min()), float(last[:, i].max())] for i, axis in enumerate("xz")}
        },
    }
    with replacing(job.folder / "metrics.json") as temporary:
        temporary.write_text(json.dumps(metrics, indent=1))
    if snapshots.body is not None:
        _log.info("The whole body for ParaView: %s", write_series(snapshots.body, job.folder / "paraview"))
