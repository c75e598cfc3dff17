"""What a job knows of being a trial: its folder holds a ticket, so that it may run in any process."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.files import replacing

TICKET = "trial.json"
PRUNED = "pruned"
"""What the job of a pruned trial returns."""
REPORTS = 50  # intermediate values of a training; more would cost more than short epochs


class TrialPruned(LabError):
    """The pruner stopped this training, as others did better so far."""


@dataclass(frozen=True)
class Ticket:
    """The trial that a job belongs to.

    Attributes
    ----------
    study
        Name of the study.
    storage
        URL of its database, or None for the journal in the study's folder.
    number, trial_id
        Number in the study, and Optuna's key.
    pruner
        Class and arguments, or None.
    report
        What the pruner sees, `SELECTION` or "raw/<loss>".
    trial_seconds
        Time limit [s], or None.
    """

    study: str
    storage: str | None
    number: int
    trial_id: int
    pruner: Mapping[str, Any] | None
    report: str
    trial_seconds: float | None

    def write(self, folder: Path) -> None:
        """Put the ticket into the folder of the job, which it may have to make."""
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(folder / TICKET) as temporary:
            temporary.write_text(json.dumps(asdict(self)), encoding="utf-8")


def ticket(folder: Path) -> Ticket | None:
    """The ticket in the folder of a job, None if it is no trial."""
    file = folder / TICKET
    return Ticket(**json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else None


@contextmanager
def time_limit(folder: Path) -> Iterator[None]:
    """Break off a trial that takes longer than its limit; Python must get its turn between two compiled calls.

    Raises
    ------
    LabError
        When the time is over.
    """
    mine = ticket(folder)
    if mine is None or mine.trial_seconds is None:
        yield
        return
    limit = mine.trial_seconds
    if threading.current_thread() is not threading.main_thread():
        raise InputError("hydra.sweeper.trial_seconds needs trials that run in the main thread of a process.")

    def stop(*_: object) -> None:
        raise LabError(f"The trial took longer than hydra.sweeper.trial_seconds={limit:g} s.")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, limit)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
