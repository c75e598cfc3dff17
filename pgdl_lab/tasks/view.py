"""Task `view`: a trained surrogate in one HTML file that needs no network."""

import logging

from pgdl_lab.core import paths
from pgdl_lab.core.files import replacing
from pgdl_lab.core.registry import describe
from pgdl_lab.running.cache import simulate
from pgdl_lab.running.folders import stored_surrogate
from pgdl_lab.running.tracking import add_artifacts
from pgdl_lab.surrogate.viewer import page
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Write viewer.html beside the surrogate.

    Raises
    ------
    LabError
        When there is no surrogate in the run's folder.
    """
    surrogate = stored_surrogate(job.folder)
    finger, fem = job.experiment.finger, job.experiment.fem
    snapshots, *_ = simulate(finger, fem, job.experiment.observation, paths.RUNS / "snapshots")
    path = job.folder / "viewer.html"
    with replacing(path) as temporary:
        temporary.write_text(page(surrogate, snapshots, f"Finger “{describe(finger)['name']}”"), encoding="utf-8")
    add_artifacts(job.folder, [path])
    _log.info("Open %s in a browser (%.1f MB)", path, path.stat().st_size / 1e6)
