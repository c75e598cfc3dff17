"""The pruner of a study, seen from inside a training."""

from pathlib import Path

import lightning.pytorch as pl
import optuna
from hydra.utils import instantiate

from pgdl_lab.learning.module import TrainingModule
from pgdl_lab.registry import closest
from pgdl_lab.search.storage import open_storage
from pgdl_lab.search.study import making
from pgdl_lab.search.trial import REPORTS, Ticket, TrialPruned


class Pruning(pl.Callback):
    """Reports the training loss to the study and stops the training when its pruner says so.

    Parameters
    ----------
    ticket
        The trial.
    folder
        Folder of the job, inside that of the study.
    """

    def __init__(self, ticket: Ticket, folder: Path) -> None:
        storage = open_storage(ticket.storage, folder.parent)
        with making("pruner"):
            pruner = instantiate(ticket.pruner)
        study = optuna.load_study(study_name=ticket.study, storage=storage, pruner=pruner)
        self._trial = optuna.trial.Trial(study, ticket.trial_id)
        self._report = ticket.report

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        assert isinstance(pl_module, TrainingModule)
        epoch, last = trainer.current_epoch + 1, trainer.max_epochs or 1
        if epoch % max(1, last // REPORTS):
            return
        terms = {f"raw/{name}": value for name, value in pl_module.means().items()}
        value = terms[closest(self._report, terms, "value of hydra.sweeper.report")]
        self._trial.report(value, epoch)
        if self._trial.should_prune():
            raise TrialPruned(f"Pruned after epoch {epoch}, as {self._report}={value:.3g} is behind other trials.")
