"""Task `paraview`: the side face by finite elements and by a trained surrogate, as an XDMF time series."""

import logging

from pgdl_lab.core import paths
from pgdl_lab.running.cache import simulate
from pgdl_lab.running.folders import stored_surrogate
from pgdl_lab.running.paraview import write_face
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Write paraview/face.xdmf beside the surrogate.

    Raises
    ------
    LabError
        When there is no surrogate in the run's folder.
    """
    surrogate, made = stored_surrogate(job.folder), job.experiment
    snapshots, *_ = simulate(made.finger, made.fem, made.observation, paths.RUNS / "snapshots")
    path = job.folder / "paraview" / "face.xdmf"
    write_face(surrogate, snapshots, path)
    _log.info("Open %s in ParaView", path)
