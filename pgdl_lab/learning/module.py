"""The training loop of a field, as a Lightning module."""

from __future__ import annotations

import logging
import math
import time
from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor

from pgdl_lab.core.errors import LabError
from pgdl_lab.learning.clock import Clock
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.objective import Objective
from pgdl_lab.learning.plan import Plan
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
from pgdl_lab.learning.stages import Stage, stages

_log = logging.getLogger(__name__)

RECORDING = 0.01  # share of the training time that entries of the loss history may take


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

    The state of the field that errs least on the points set aside is kept beside the last one, which training goes on
    from; `settle` takes it, unless it does not surely err less than that before the first step. Every random choice of
    an epoch follows from the seed and the epoch's number, and a checkpoint holds the place within the epoch, so that a
    resumed training goes on as if it had never stopped.

    Parameters
    ----------
    objective
        What is minimised.
    held
        Points set aside.
    trainer_settings, optimizer_settings
        Budget and rule.
    seed
        Fixes batches and drawn points.
    clock
        The budget in time.
    identity
        What a training must agree on to resume from a checkpoint of this one (JSON types).
    patience
        Epochs without a better state, or without one that surely gains on the start, after which the training ends;
        None: it never ends before its budget.
    """

    held_inputs: Tensor
    held_cases: Tensor
    held_targets: Tensor

    def __init__(
        self,
        objective: Objective,
        held: Samples,
        trainer_settings: TrainerSettings,
        optimizer_settings: OptimizerSettings,
        seed: int,
        clock: Clock,
        identity: dict[str, Any],
        patience: int | None = None,
    ) -> None:
        super().__init__()
        self.automatic_optimization = False  # one training may go through several optimisers
        self.objective = objective
        self.budget = trainer_settings
        self.rule = optimizer_settings
        self.seed = seed
        self.clock = clock
        self.identity = identity
        self.patience = patience
        self.history: list[dict[str, float]] = []
        self.stopped = ""  # why the training ended before its budget
        self.generator = torch.Generator()
        self.last_good = self._weights()
        self.best: dict[str, Any] = {}
        held_fields = objective.field.coordinates(held.points_mm, 0), held.cases.values, held.displacements_mm
        for name, data in zip(("inputs", "cases", "targets"), held_fields, strict=True):
            self.register_buffer(f"held_{name}", torch.as_tensor(data).to(objective.targets), persistent=False)
        self._stages: list[Stage] = stages(objective, optimizer_settings)
        self._plan = Plan(len(self._stages), trainer_settings.max_epochs, self.steps_per_epoch, clock)
        self._epoch, self._done = 0, 0  # the present epoch and how many of its steps are done
        self._drawn_from = 0
        self._order = torch.empty(0, dtype=torch.long)
        self._batch = self._order
        self._sums: dict[str, Tensor] = {}
        self._summed = 0
        self._within: dict[str, Any] | None = None  # where within an epoch a resumed training goes on
        self._recording_s = 0.0  # that the last entry of the history took

    @property
    def samples(self) -> int:
        """Number of training points."""
        return len(self.objective.cases)

    @property
    def steps_per_epoch(self) -> int:
        """Number of batches that an epoch is cut into."""
        return math.ceil(self.samples / self.rule.batch_size)

    @property
    def step(self) -> int:
        """Number of steps that are done."""
        return self._epoch * self.steps_per_epoch + self._done

    @property
    def within_epoch(self) -> bool:
        """Whether the present epoch has steps that are not done."""
        return self._done < self.steps_per_epoch

    @property
    def progress(self) -> float:
        """Share of the budget that is spent, by steps or by time, whichever is further."""
        return self._plan.progress_of_all(self.step)

    @property
    def finished(self) -> bool:
        """Whether nothing is left of the budget, or the training ended before."""
        spent = self._plan.last and self.step >= self._plan.end
        return bool(self.stopped) or spent or not self.clock.left_s

    @property
    def _at_work(self) -> Stage:
        return self._stages[self._plan.stage]

    def configure_optimizers(self) -> list[torch.optim.Optimizer]:
        return [optimizer for stage in self._stages for optimizer in stage.optimizers]

    def on_train_start(self) -> None:
        if not self.best:
            self._keep_best()
        if self._within is not None:
            self._go_on_within_epoch(self._within)

    def on_train_epoch_start(self) -> None:
        self._epoch, self._done = self.current_epoch, 0
        if self.step >= self._plan.end and not self._plan.last:
            self._next_stage("its share of the budget is spent")
        # full batches draw alike in all epochs
        self._drawn_from = 0 if self._at_work.full_batch else self._epoch
        self._draw_order()
        self._sums, self._summed = {}, 0

    def _draw_order(self) -> None:
        self._reseed()
        self._order = torch.randperm(self.samples, generator=self.generator).to(self.device)

    def _reseed(self) -> None:
        """Draw from here on what follows from the seed and the epoch."""
        self.generator.manual_seed((self.seed * 1_000_003 + self._drawn_from) % 2**63)

    def on_train_batch_start(self, batch: int, batch_idx: int) -> None:
        self._plan.begins(self.step, self._at_work.full_batch)
        if self.rule.schedule == "cosine":
            share = self._plan.progress(self.step)
            self._at_work.scale_rate(self.rule.lr * (1 + math.cos(math.pi * share)) / 2)

    def training_step(self, batch: int, batch_idx: int) -> None:
        """Step on the `batch_idx`-th slice of this epoch's order; full batches are taken once per epoch.

        `batch` counts anew where a resumed training goes on within an epoch, `batch_idx` does not.
        """
        reason = None if self._at_work.full_batch and batch_idx else self._take_step(batch_idx)
        self._done = batch_idx + 1
        if reason is not None:
            self._next_stage(reason)
        # an epoch of one step is not cut into parts
        if self.finished and self.within_epoch and not self._at_work.full_batch:
            self.trainer.should_stop = True
            self._close_epoch(last=True)

    def _take_step(self, number: int) -> str | None:
        """The step with this `number` in the epoch; the reason if the optimiser should take no other."""
        stage = self._at_work
        size = self.samples if stage.full_batch else self.rule.batch_size
        self._batch = self._order[number * size : (number + 1) * size]
        first = True

        def closure() -> Tensor:
            nonlocal first
            if stage.full_batch:
                self._reseed()
            terms = self.objective.terms(self._batch, self.generator)
            if first:
                for name, value in terms.items():
                    self._sums[name] = self._sums.get(name, torch.zeros_like(value)) + value.detach()
                self._summed += 1
                # curvature that is remembered or trial steps that are compared belong to one objective
                if not stage.full_batch and self.objective.balancer.due(self.step):
                    self.objective.balance(terms, self.generator)
            total = self.objective.total(terms)
            if first:
                self._check(terms, total)
                first = False
            for weight in self.objective.field.parameters():
                weight.grad = None
            torch.autograd.backward(total)
            return total.detach()

        return stage.step(closure)

    def _check(self, terms: dict[str, Tensor], total: Tensor) -> None:
        if not torch.isfinite(total):
            broken = [name for name, value in terms.items() if not torch.isfinite(value)]
            self._diverged(f"loss {' and '.join(broken) or 'total'} is no longer finite")

    def _next_stage(self, reason: str) -> None:
        name, epochs = self.rule.stages[self._plan.stage], math.ceil(self.step / self.steps_per_epoch)
        _log.info("Optimizer %s ends after epoch %d: %s.", name, epochs, reason)
        if self._plan.last:
            self.stopped = reason
        else:
            self._plan.start(self._plan.stage + 1, self.step)

    def on_train_epoch_end(self) -> None:
        if self.within_epoch:
            return  # it was cut, and is closed
        self._keep_best()
        if self.best and self.patience is not None and not self.stopped:
            waited = self._epoch + 1 - (self.best["epoch"] if self._gained() else 0)
            if waited >= self.patience:
                self.stopped = f"no surely better state in {waited} epochs"
        self.trainer.should_stop = self.trainer.should_stop or self.finished
        self._close_epoch(last=self.trainer.should_stop or self._epoch + 1 >= self.budget.max_epochs)

    def _close_epoch(self, last: bool) -> None:
        """Check the weights and, if it is time to, add an entry to the history."""
        if not all(torch.isfinite(weight).all() for weight in self.objective.field.parameters()):
            self._diverged("a weight is no longer finite")
        self.last_good = self._weights()
        least_s = self.budget.log_every_s and max(self.budget.log_every_s, self._recording_s / RECORDING)
        if last or not self.history or self.clock.seconds - self.history[-1]["seconds"] >= least_s:
            start = time.monotonic()
            self._record()
            self._recording_s = time.monotonic() - start

    @torch.no_grad()
    def _validation(self) -> Tensor:
        """Squared errors (m,), summed over both components, at the points that are set aside, on the CPU [mm²]."""
        predicted = self.objective.field(self.held_inputs, self.held_cases)
        return (predicted - self.held_targets).square().sum(dim=1).cpu()

    def _keep_best(self) -> None:
        if not len(self.held_cases):
            return
        errors = self._validation()
        state = {"mse": float(errors.mean()), "errors": errors, "weights": self._weights()}
        if not self.best:
            self.best = {**state, "epoch": 0, "start": state}
        elif state["mse"] < self.best["mse"]:
            self.best |= {**state, "epoch": math.ceil(self.step / self.steps_per_epoch)}

    def _gained(self) -> bool:
        """Whether the best state surely errs less than that before the first step."""
        return surely_less(self.best["errors"], self.best["start"]["errors"])

    def settle(self) -> None:
        """Give the field the best of all states, the last one too, which no checkpoint need hold."""
        self._keep_best()
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
        return {name: float(total) / max(self._summed, 1) for name, total in self._sums.items()}

    def _record(self) -> None:
        """Add an entry to the loss history: mean terms of this epoch, gradient shares on its last batch.

        The entry of an epoch that was cut has a fraction of it for its number.
        """
        drawn = self.generator.get_state()
        with torch.enable_grad():
            shares = self.objective.gradient_shares(self.objective.terms(self._batch, self.generator))
        self.generator.set_state(drawn)
        entry = {
            "epoch": self.step / self.steps_per_epoch,
            "seconds": self.clock.seconds,
            "lr": float(self._at_work.optimizers[0].param_groups[0].get("lr", math.nan)),
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
            self.logger.log_metrics(metrics, step=math.ceil(entry["epoch"]))

    def _weights(self) -> dict[str, Tensor]:
        """A copy of the weights, on the CPU, where those of a checkpoint are too."""
        return {name: weight.detach().to("cpu", copy=True) for name, weight in self.objective.field.named_parameters()}

    def _diverged(self, what: str) -> None:
        raise TrainingDiverged(
            f"Training stopped in epoch {self._epoch + 1}: {what}; the weights of the epoch before are kept; "
            f"lower optimizer.lr ({self.rule.lr:g}) or the weight of that loss."
        )

    def restore_last_good(self) -> None:
        """Put back the weights of the last epoch whose losses and weights were finite, or the best ones."""
        self.objective.field.load_state_dict(self.last_good, strict=False)
        self.settle()

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["identity"] = self.identity
        checkpoint["elapsed_s"] = self.clock.seconds
        checkpoint["history"] = self.history
        checkpoint["balance"] = self.objective.balancer.state()
        checkpoint["best"] = self.best
        checkpoint["stopped"] = self.stopped
        checkpoint["plan"] = self._plan.state()
        checkpoint["stages"] = [stage.state() for stage in self._stages]
        checkpoint["place"] = {
            "epoch": self._epoch,
            "done": self._done,
            "drawn_from": self._drawn_from,
            "generator": self.generator.get_state(),
            "sums": {name: value.cpu() for name, value in self._sums.items()},
            "summed": self._summed,
        }

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.history = list(checkpoint["history"])
        self.objective.balancer.restore(checkpoint["balance"])
        self.best = checkpoint["best"]
        self.stopped = checkpoint["stopped"]
        self._plan.restore(checkpoint["plan"])
        for stage, state in zip(self._stages, checkpoint["stages"], strict=True):
            stage.restore(state)
        place = checkpoint["place"]
        self._epoch, self._done = place["epoch"], place["done"]
        self._within = place if self.within_epoch else None

    def _go_on_within_epoch(self, place: dict[str, Any]) -> None:
        if self.history and self.history[-1]["epoch"] % 1:  # that of an epoch that is not cut any more
            self.history.pop()
        self._drawn_from = place["drawn_from"]
        self._draw_order()
        self.generator.set_state(place["generator"])
        self._sums = {name: value.to(self.device) for name, value in place["sums"].items()}
        self._summed = place["summed"]
        self._within = None
