"""Task `log`: what MLflow missed of a run or multirun, told now."""

import logging

from pgdl_lab.running.tracking import log_again
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Log what MLflow does not have yet; again, it does no harm.

    Raises
    ------
    LabError
        When MLflow does not answer.
    """
    count = log_again(job.folder)
    _log.info("MLflow has all of %s: %s", job.folder, f"{count} logged now" if count else "it missed nothing")
