"""Task `simulate`: only the snapshots of the finite-element model, and the whole body for ParaView."""

import json
import logging
import time

from pgdl_lab.core import paths
from pgdl_lab.core.files import replacing
from pgdl_lab.core.registry import describe
from pgdl_lab.running.cache import simulate
from pgdl_lab.running.paraview import write_series
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
        "warnings": snapshots.warnings,
        "discretisation_error": snapshots.provenance.get("discretisation_error"),
        "seconds": {"simulate": snapshots.provenance.get("seconds", time.perf_counter() - start)},
        "extremes_mm": {
            "fem": {
                axis: [float(last[:, i].min()), float(last[:, i].max())] for i, axis in enumerate(snapshots.domain.axes)
            }
        },
    }
    with replacing(job.folder / "metrics.json") as temporary:
        temporary.write_text(json.dumps(metrics, indent=1))
    if error := metrics["discretisation_error"]:
        _log.info(
            "On half the edges the tip would lie %.2g mm elsewhere at %.4g kPa, %.2g %% of its displacement, and other "
            "points up to %.2g mm.", error["tip_mm"], error["kpa"], error["tip_percent"], error["largest_mm"],
        )  # fmt: skip
    else:
        _log.info("The discretisation error is not known: nothing estimated it.")
    body = snapshots if snapshots.domain.is_body else snapshots.body
    if body is not None:
        _log.info("The whole body for ParaView: %s", write_series(body, job.folder / "paraview"))
