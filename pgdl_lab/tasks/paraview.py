"""Task `paraview`: what was observed by finite elements and by a trained surrogate, as a time series."""

import logging

from pgdl_lab.core import paths
from pgdl_lab.running.cache import simulate
from pgdl_lab.running.folders import stored_surrogate
from pgdl_lab.running.paraview import write_body, write_face
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Write paraview/face.xdmf beside the surrogate, or paraview/body.pvd of a whole body.

    Raises
    ------
    LabError
        When there is no surrogate in the run's folder.
    """
    surrogate, made = stored_surrogate(job.folder), job.experiment
    snapshots, *_ = simulate(made.finger, made.fem, made.observation, paths.RUNS / "snapshots")
    folder = job.folder / "paraview"
    if snapshots.domain.is_body:
        path = write_body(surrogate, snapshots, folder)
    else:
        path = folder / "face.xdmf"
        write_face(surrogate, snapshots, path)
    _log.info("Open %s in ParaView", path)
