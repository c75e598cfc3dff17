"""What happens beside a training: checkpoints and the progress bar."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
from lightning.pytorch import callbacks
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from pgdl_lab.core.errors import LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.heard import ASIDE
from pgdl_lab.learning.module import TrainingModule

_log = logging.getLogger(__name__)


class Checkpoint(callbacks.Checkpoint):
    """Writes `path` at the end of a step, when the last time is `every_s` ago, and at the end of the training.

    The file is written to a temporary name and renamed, so that a kill at any time leaves a whole one. Being of
    Lightning's kind of checkpoint callback, this one runs after the module has checked and recorded an epoch.

    Parameters
    ----------
    path
        The checkpoint file.
    every_s
        Time between checkpoints [s].
    """

    def __init__(self, path: Path, every_s: float) -> None:
        self.path = path
        self.every_s = every_s
        self._written_s = time.monotonic()

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        assert isinstance(pl_module, TrainingModule)
        if pl_module.within_epoch:  # else there is still something to do at its end
            self._write(trainer, last=trainer.should_stop)

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        assert isinstance(pl_module, TrainingModule)
        if not pl_module.within_epoch:  # else it was cut, and that is written
            self._write(trainer, last=trainer.should_stop or trainer.current_epoch + 1 >= (trainer.max_epochs or 0))

    def _write(self, trainer: pl.Trainer, last: bool) -> None:
        if last or time.monotonic() - self._written_s >= self.every_s:
            try:
                with replacing(self.path) as temporary:
                    trainer.save_checkpoint(temporary)
            except (LabError, OSError) as error:  # without it the training can still come to its end
                _log.warning("The checkpoint could not be written: %s", error, extra=ASIDE)
            self._written_s = time.monotonic()


class ProgressBar(pl.Callback):
    """One line: share of the budget, epoch, total loss of the last history entry."""

    def __init__(self) -> None:
        self._bar = Progress(
            TextColumn("training"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeElapsedColumn(),
            TextColumn("{task.description}"),
        )  # fmt: skip
        self._task: TaskID | None = None

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        self._task = self._bar.add_task("", total=1.0)
        self._bar.start()

    def on_train_epoch_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        assert isinstance(pl_module, TrainingModule) and self._task is not None
        # Lightning calls callbacks before the module, so the entry is that of an epoch before
        loss = f", loss {pl_module.history[-1]['loss']:.3g}" if pl_module.history else ""
        description = f"epoch {trainer.current_epoch + 1}{loss}"
        self._bar.update(self._task, completed=pl_module.progress, description=description)

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        self._bar.stop()

    def on_exception(self, trainer: pl.Trainer, pl_module: pl.LightningModule, exception: BaseException) -> None:
        self._bar.stop()
