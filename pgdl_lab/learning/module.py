"""The training loop of a field, as a Lightning module."""

from __future__ import annotations

import logging
import math
import time
from typing import Any

import lightning.pytorch as pl
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.errors import LabError
from pgdl_lab.learning.objective import Objective
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
from pgdl_lab.learning.stages import Stage, stages

_log = logging.getLogger(__name__)

RECORDING = 0.01  # share of the training time that entries of the loss history may take
SLACK = 0.05  # share of the time budget by which a training may lag behind its epochs before its schedule is shortened


class TrainingDiverged(LabError):
    """A loss or a weight is no longer finite.

    Attributes
    ----------
    surrogate
        The surrogate with the last good weights; set by `fit`.
    """

    surrogate: Any = None


def surely_less(errors: Tensor, others: Tensor) -> bool:
    """Whether squared `errors` (m,) are less than `others` (m,) on average, and at most points by more than chance.

    The best of many states looks better than it is where it was chosen. The logarithm of the ratio of both is compared
    with its standard error, of which three are more than that: errors differ so much from point to point that their
    mean over a few tells nothing sure, even where each is a hundred times less.
    """
    if len(errors) < 2 or not errors.mean() < others.mean():
        return False
    tiny = torch.finfo(others.dtype).tiny
    gain = others.clamp_min(tiny).log() - errors.clamp_min(tiny).log()
    return bool(gain.mean() > 3 * gain.std() / math.sqrt(len(gain)))


class TrainingModule(pl.LightningModule):
    """Trains the field of an objective on batches that are slices of shuffled training points.

    A part of the training points is set aside for validation, and the state of the field that errs least on them is
    kept, unless it does not surely err less than that before the first step. Every random choice of an epoch follows
    from the seed and the epoch's number, so that a resumed training goes on as if it had never stopped.

    Parameters
    ----------
    objective
        What is minimised.
    trainer_settings, optimizer_settings
        Budget and rule.
    seed
        Fixes batches and drawn points.
    patience
        Epochs without a better state, or without one that surely gains on the start, after which the training ends;
        None: it never ends before its budget.
    """

    def __init__(
        self,
        objective: Objective,
        trainer_settings: TrainerSettings,
        optimizer_settings: OptimizerSettings,
        seed: int,
        patience: int | None = None,
    ) -> None:
        super().__init__()
        self.automatic_optimization = False  # one training may go through several optimisers
        self.objective = objective
        self.budget = trainer_settings
        self.rule = optimizer_settings
        self.seed = seed
        self.patience = patience
        self.history: list[dict[str, float]] = []
        self.elapsed_s = 0.0
        self.stopped = ""  # why the training ended before its budget
        self.generator = torch.Generator()
        self.last_good = self._weights()
        self.best: dict[str, Any] = {}
        count = len(objective.pressures)
        order = torch.randperm(count, generator=torch.Generator().manual_seed(seed))
        self._held, self._training = torch.split(
            order, [held := int(trainer_settings.validation * count), count - held]
        )
        self._stages: list[Stage] = stages(objective, optimizer_settings)
        self._stage, self._stage_began = 0, 0.0
        self._order = torch.empty(0, dtype=torch.long)
        self._batch = self._order
        self._sums: dict[str, Tensor] = {}
        self._steps = 0
        self._batches = 0
        self._started_s = 0.0
        self._recording_s = 0.0  # that the last entry of the history took

    @property
    def samples(self) -> int:
        """Number of training points, without those that are set aside."""
        return len(self._training)

    @property
    def held(self) -> NDArray[np.bool_]:
        """(n,), the samples that are set aside."""
        mask = np.zeros(len(self._held) + len(self._training), dtype=bool)
        mask[self._held.cpu()] = True
        return mask

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
        by_epochs = self._batches / (self.steps_per_epoch * self.budget.max_epochs)
        by_time = (self.seconds / self.budget.max_seconds - SLACK) / (1 - SLACK)
        return min(max(by_epochs, by_time), 1.0)

    @property
    def stage_progress(self) -> float:
        """Share of the present optimiser's budget that is spent; those still to come share the rest equally."""
        length = (1 - self._stage_began) / (len(self._stages) - self._stage)
        return min((self.progress - self._stage_began) / length, 1.0) if length else 1.0

    def configure_optimizers(self) -> list[torch.optim.Optimizer]:
        return [optimizer for stage in self._stages for optimizer in stage.optimizers]

    def on_train_start(self) -> None:
        self._started_s = time.monotonic()
        self._held, self._training = self._held.to(self.device), self._training.to(self.device)
        if not self.best:
            self._keep_best()

    def on_train_epoch_start(self) -> None:
        if self.stage_progress >= 1 and self._stage + 1 < len(self._stages):
            self._next_stage("its share of the budget is spent")
        self._reseed()
        self._order = self._training[torch.randperm(self.samples, generator=self.generator).to(self.device)]
        self._sums, self._steps = {}, 0

    def _reseed(self) -> None:
        """Draw from here on what follows from the seed and the epoch; full batches draw alike in all epochs."""
        epoch = 0 if self._stages[self._stage].full_batch else self.current_epoch
        self.generator.manual_seed((self.seed * 1_000_003 + epoch) % 2**63)

    def on_train_batch_start(self, batch: int, batch_idx: int) -> None:
        self._batches = self.current_epoch * self.steps_per_epoch + batch_idx
        if self.rule.schedule == "cosine":
            self._stages[self._stage].scale_rate(self.rule.lr * (1 + math.cos(math.pi * self.stage_progress)) / 2)

    def training_step(self, batch: int, batch_idx: int) -> None:
        """Step on the `batch`-th slice of this epoch's order; full batches are taken once per epoch."""
        stage = self._stages[self._stage]
        if stage.full_batch and batch:
            return
        size = self.samples if stage.full_batch else self.rule.batch_size
        self._batch = self._order[batch * size : (batch + 1) * size]
        first = True

        def closure() -> Tensor:
            nonlocal first
            if stage.full_batch:
                self._reseed()
            terms = self.objective.terms(self._batch, self.generator)
            if first:
                for name, value in terms.items():
                    self._sums[name] = self._sums.get(name, torch.zeros_like(value)) + value.detach()
                self._steps += 1
                # curvature that is remembered or trial steps that are compared belong to one objective
                if not stage.full_batch and self.objective.balancer.due(self._batches):
                    self.objective.balance(terms, self.generator)
            total = self.objective.total(terms)
            if first:
                self._check(terms, total)
                first = False
            for weight in self.objective.field.parameters():
                weight.grad = None
            torch.autograd.backward(total)
            return total.detach()

        reason = stage.step(closure)
        if reason is not None:
            self._next_stage(reason)

    def _check(self, terms: dict[str, Tensor], total: Tensor) -> None:
        if not torch.isfinite(total):
            broken = [name for name, value in terms.items() if not torch.isfinite(value)]
            self._diverged(f"loss {' and '.join(broken) or 'total'} is no longer finite")

    def _next_stage(self, reason: str) -> None:
        name = self.rule.stages[self._stage]
        _log.info("Optimizer %s ends after epoch %d: %s.", name, self.current_epoch + 1, reason)
        if self._stage + 1 < len(self._stages):
            self._stage, self._stage_began = self._stage + 1, self.progress
        else:
            self._stop(reason)

    def _stop(self, reason: str) -> None:
        self.stopped = reason
        self.trainer.should_stop = True

    def on_train_batch_end(self, outputs: Any, batch: int, batch_idx: int) -> None:
        self._batches += 1
        if self.seconds >= self.budget.max_seconds:
            self.trainer.should_stop = True

    def on_train_epoch_end(self) -> None:
        if not all(torch.isfinite(weight).all() for weight in self.objective.field.parameters()):
            self._diverged("a weight is no longer finite")
        self.last_good = self._weights()
        self._keep_best()
        if self.best and self.patience is not None and not self.stopped:
            waited = self.current_epoch + 1 - (self.best["epoch"] if self._gained() else 0)
            if waited >= self.patience:
                self._stop(f"no surely better state in {waited} epochs")
        last = self.trainer.should_stop or self.current_epoch + 1 >= self.budget.max_epochs
        least = self.budget.log_every_s and max(self.budget.log_every_s, self._recording_s / RECORDING)
        if last or not self.history or self.seconds - self.history[-1]["seconds"] >= least:
            start = time.monotonic()
            self._record()
            self._recording_s = time.monotonic() - start
        if last:
            self._restore_best()

    @torch.no_grad()
    def _validation(self) -> Tensor:
        """Squared errors (m,), summed over both components, at the points that are set aside [mm²]."""
        objective = self.objective
        predicted = objective.field(objective.inputs[:1, self._held], objective.pressures[self._held])
        return (predicted - objective.targets[self._held]).square().sum(dim=1)

    def _keep_best(self) -> None:
        if not len(self._held):
            return
        errors = self._validation()
        state = {"mse": float(errors.mean()), "errors": errors, "weights": self._weights()}
        if not self.best:
            self.best = {**state, "epoch": 0, "start": state}
        elif state["mse"] < self.best["mse"]:
            self.best |= {**state, "epoch": self.current_epoch + 1}

    def _gained(self) -> bool:
        """Whether the best state surely errs less than that before the first step."""
        return surely_less(self.best["errors"], self.best["start"]["errors"])

    def _restore_best(self) -> None:
        if not self.best:
            return
        start, gained = self.best["start"], self._gained()
        kept = self.best if gained else start
        self.objective.field.load_state_dict(kept["weights"], strict=False)
        _log.info(
            "Points set aside: mean squared error %.4g mm² before training, %.4g mm² at best, after epoch %d: %s.",
            start["mse"], self.best["mse"], self.best["epoch"],
            "that state is kept" if gained else "no sure gain, so the state before training is kept",
        )  # fmt: skip

    def means(self) -> dict[str, float]:
        """Mean of each loss term over the batches of this epoch."""
        return {name: float(total) / max(self._steps, 1) for name, total in self._sums.items()}

    def _record(self) -> None:
        """Add an entry to the loss history: mean terms of this epoch, gradient shares on its last batch."""
        with torch.enable_grad():
            shares = self.objective.gradient_shares(self.objective.terms(self._batch, self.generator))
        entry = {
            "epoch": float(self.current_epoch + 1),
            "seconds": self.seconds,
            "lr": float(self._stages[self._stage].optimizers[0].param_groups[0].get("lr", math.nan)),
        }
        for name, raw in self.means().items():
            entry |= {
                f"raw/{name}": raw,
                f"weight/{name}": self.objective.weight(name),
                f"weighted/{name}": self.objective.weight(name) * raw,
                f"share/{name}": shares[name],
            }
        entry["loss"] = sum(value for key, value in entry.items() if key.startswith("weighted/"))
        if self.best:
            entry["validation"] = float(self._validation().mean())
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
        checkpoint["best"] = self.best
        checkpoint["stopped"] = self.stopped
        checkpoint["stage"] = self._stage, self._stage_began

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.elapsed_s = checkpoint["elapsed_s"]
        self.history = list(checkpoint["history"])
        if "balance" in checkpoint:  # checkpoints of earlier versions have none
            self.objective.balancer.restore(checkpoint["balance"])
        self.best = checkpoint["best"]
        self.stopped = checkpoint["stopped"]
        self._stage, self._stage_began = checkpoint["stage"]
