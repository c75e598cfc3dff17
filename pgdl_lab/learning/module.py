"""The training loop of a field, as a Lightning module."""

from __future__ import annotations

import math
import time
from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor

from pgdl_lab.errors import LabError
from pgdl_lab.learning.objective import Objective
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings

OPTIMIZERS = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW, "nadam": torch.optim.NAdam}
SLACK = 0.05  # share of the time budget by which a training may lag behind its epochs before its schedule is shortened


class TrainingDiverged(LabError):
    """A loss or a weight is no longer finite.

    Attributes
    ----------
    surrogate
        The surrogate with the last good weights; set by `fit`.
    """

    surrogate: Any = None


class TrainingModule(pl.LightningModule):
    """Trains the field of an objective on batches that are slices of shuffled training points.

    Every random choice of an epoch follows from the seed and the epoch's number, so that a resumed training goes on as
    if it had never stopped.

    Parameters
    ----------
    objective
        What is minimised.
    trainer_settings, optimizer_settings
        Budget and rule.
    seed
        Fixes batches and drawn points.
    """

    def __init__(
        self, objective: Objective, trainer_settings: TrainerSettings, optimizer_settings: OptimizerSettings, seed: int
    ) -> None:
        super().__init__()
        self.objective = objective
        self.budget = trainer_settings
        self.rule = optimizer_settings
        self.seed = seed
        self.history: list[dict[str, float]] = []
        self.elapsed_s = 0.0
        self.generator = torch.Generator()
        self.last_good = self._weights()
        self._order = torch.empty(0, dtype=torch.long)
        self._batch = self._order
        self._sums: dict[str, Tensor] = {}
        self._started_s = 0.0

    @property
    def samples(self) -> int:
        """Number of training points."""
        return len(self.objective.pressures)

    @property
    def steps_per_epoch(self) -> int:
        """Number of batches that an epoch is cut into."""
        return math.ceil(self.samples / self.rule.batch_size)

    @property
    def seconds(self) -> float:
        """Training time so far, with the time before a resume [s]."""
        return self.elapsed_s + time.monotonic() - self._started_s

    @property
    def progress(self) -> float:
        """Share of the budget that is spent, by epochs or by time, whichever is further."""
        by_epochs = self.global_step / (self.steps_per_epoch * self.budget.max_epochs)
        by_time = (self.seconds / self.budget.max_seconds - SLACK) / (1 - SLACK)
        return min(max(by_epochs, by_time), 1.0)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        optimizer: torch.optim.Optimizer = OPTIMIZERS[self.rule.name](
            self.objective.field.parameters(), lr=self.rule.lr, weight_decay=self.rule.weight_decay
        )
        return optimizer

    def on_train_start(self) -> None:
        self._started_s = time.monotonic()

    def on_train_epoch_start(self) -> None:
        self.generator.manual_seed((self.seed * 1_000_003 + self.current_epoch) % 2**63)
        self._order = torch.randperm(self.samples, generator=self.generator).to(self.device)
        self._sums = {}

    def on_train_batch_start(self, batch: int, batch_idx: int) -> None:
        if self.rule.schedule == "cosine":
            factor = (1 + math.cos(math.pi * self.progress)) / 2
            for group in self.trainer.optimizers[0].param_groups:
                group["lr"] = self.rule.lr * factor

    def training_step(self, batch: int, batch_idx: int) -> Tensor:
        """Total loss of the `batch`-th slice of this epoch's order."""
        self._batch = self._order[batch * self.rule.batch_size : (batch + 1) * self.rule.batch_size]
        terms = self.objective.terms(self._batch, self.generator)
        for name, value in terms.items():
            self._sums[name] = self._sums.get(name, torch.zeros_like(value)) + value.detach()
        if self.objective.balancer.due(self.global_step):
            self.objective.balance(terms, self.generator)
        total = self.objective.total(terms)
        if not torch.isfinite(total):
            broken = [name for name, value in terms.items() if not torch.isfinite(value)]
            self._diverged(f"loss {' and '.join(broken) or 'total'} is no longer finite")
        return total

    def on_train_batch_end(self, outputs: Any, batch: int, batch_idx: int) -> None:
        if self.seconds >= self.budget.max_seconds:
            self.trainer.should_stop = True

    def on_train_epoch_end(self) -> None:
        if not all(torch.isfinite(weight).all() for weight in self.objective.field.parameters()):
            self._diverged("a weight is no longer finite")
        self.last_good = self._weights()
        last = self.trainer.should_stop or self.current_epoch + 1 >= self.budget.max_epochs
        if last or not self.history or self.seconds - self.history[-1]["seconds"] >= self.budget.log_every_s:
            self._record()

    def means(self) -> dict[str, float]:
        """Mean of each loss term over the batches of this epoch."""
        steps = self.trainer.fit_loop.epoch_loop.batch_progress.current.completed
        return {name: float(total) / max(steps, 1) for name, total in self._sums.items()}

    def _record(self) -> None:
        """Add an entry to the loss history: mean terms of this epoch, gradient shares on its last batch."""
        with torch.enable_grad():
            shares = self.objective.gradient_shares(self.objective.terms(self._batch, self.generator))
        entry = {
            "epoch": float(self.current_epoch + 1),
            "seconds": self.seconds,
            "lr": float(self.trainer.optimizers[0].param_groups[0]["lr"]),
        }
        for name, raw in self.means().items():
            entry |= {
                f"raw/{name}": raw,
                f"weight/{name}": self.objective.weight(name),
                f"weighted/{name}": self.objective.weight(name) * raw,
                f"share/{name}": shares[name],
            }
        entry["loss"] = sum(value for key, value in entry.items() if key.startswith("weighted/"))
        self.history.append(entry)
        if self.logger is not None:
            metrics = {key: value for key, value in entry.items() if key != "epoch"}
            self.logger.log_metrics(metrics, step=self.current_epoch + 1)

    def _weights(self) -> dict[str, Tensor]:
        return {name: weight.detach().clone() for name, weight in self.objective.field.named_parameters()}

    def _diverged(self, what: str) -> None:
        raise TrainingDiverged(
            f"Training stopped in epoch {self.current_epoch + 1}: {what}; the weights of the epoch before are kept; "
            f"lower optimizer.lr ({self.rule.lr:g}) or the weight of that loss."
        )

    def restore_last_good(self) -> None:
        """Put back the weights of the last epoch whose losses and weights were finite."""
        self.objective.field.load_state_dict(self.last_good, strict=False)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["elapsed_s"] = self.seconds
        checkpoint["history"] = self.history
        checkpoint["balance"] = self.objective.balancer.state()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.elapsed_s = checkpoint["elapsed_s"]
        self.history = list(checkpoint["history"])
        if "balance" in checkpoint:  # checkpoints of earlier versions have none
            self.objective.balancer.restore(checkpoint["balance"])
