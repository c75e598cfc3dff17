"""Lightning's view of a tracked run."""

from collections.abc import Mapping
from typing import Any

from lightning.pytorch.loggers import Logger

from pgdl_lab.running.tracking import TrackedRun


class EpochLogger(Logger):
    """Lightning logger that hands the metrics of a training to an open MLflow run.

    Lightning's own MLFlowLogger writes at every call, opens and closes runs itself and needs the URI again.

    Parameters
    ----------
    run
        The open run.
    """

    def __init__(self, run: TrackedRun) -> None:
        super().__init__()
        self._run = run

    @property
    def name(self) -> str:
        """Name of the experiment; Lightning asks for it."""
        return "mlflow"

    @property
    def version(self) -> str:
        """Name of the run; Lightning asks for it."""
        return self._run.folder.name

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        self._run.log_metrics(metrics, step or 0)

    def log_hyperparams(self, *args: Any, **kwargs: Any) -> None:
        """Nothing to do: the run's parameters are its whole configuration."""

    def save(self) -> None:
        self._run.flush()
