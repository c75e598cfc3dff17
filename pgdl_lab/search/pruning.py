"""The pruner of a study, seen from inside a training."""

from pathlib import Path

import lightning.pytorch as pl
import optuna
import torch
from hydra.utils import instantiate

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import closest
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.module import TrainingModule
from pgdl_lab.learning.objective import Objective
from pgdl_lab.running.trial import REPORTS, Ticket, TrialPruned
from pgdl_lab.search.settings import NONE_LEFT, SELECTION
from pgdl_lab.search.storage import open_storage
from pgdl_lab.search.study import making


class Pruning(pl.Callback):
    """Reports how well a training does to the study and stops it when its pruner says so.

    Parameters
    ----------
    ticket
        The trial.
    folder
        Folder of the job, inside that of the study.
    selection
        The points that the search selects by.
    """

    def __init__(self, ticket: Ticket, folder: Path, selection: Samples) -> None:
        storage = open_storage(ticket.storage, folder.parent)
        with making("pruner"):
            pruner = instantiate(ticket.pruner)
        study = optuna.load_study(study_name=ticket.study, storage=storage, pruner=pruner)
        self._trial = optuna.trial.Trial(study, ticket.trial_id)
        self._report = ticket.report
        self._selection = selection
        self._inputs: torch.Tensor | None = None
        if self._report == SELECTION and not len(selection):
            raise InputError(NONE_LEFT)

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        assert isinstance(pl_module, TrainingModule)
        epoch, last = trainer.current_epoch + 1, trainer.max_epochs or 1
        if epoch % max(1, last // REPORTS):
            return
        if self._report == SELECTION:
            value = self._error_mm2(pl_module.objective)
        else:
            terms = {f"raw/{name}": value for name, value in pl_module.means().items()}
            value = terms[closest(self._report, {SELECTION: 0.0, **terms}, "value of hydra.sweeper.report")]
        self._trial.report(value, epoch)
        if self._trial.should_prune():
            raise TrialPruned(f"Pruned after epoch {epoch}, as {self._report}={value:.3g} is behind other trials.")

    @torch.no_grad()
    def _error_mm2(self, objective: Objective) -> float:
        """Mean squared error at the points to select by, summed over both components [mm²]."""
        points, like = self._selection, objective.targets
        if self._inputs is None:
            self._inputs = objective.field.coordinates(points.points_mm, 0).to(like)
        predicted = objective.field(self._inputs, torch.from_numpy(points.cases.values).to(like))
        return float((predicted - torch.from_numpy(points.displacements_mm).to(like)).square().sum(dim=1).mean())
