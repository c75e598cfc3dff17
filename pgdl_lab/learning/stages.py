"""The optimisers that a training goes through, one after the other."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from pgdl_lab.core.errors import InputError
from pgdl_lab.learning.levenberg_marquardt import LevenbergMarquardt
from pgdl_lab.learning.objective import Objective
from pgdl_lab.learning.settings import FULL_BATCH, OptimizerSettings

Closure = Callable[[], Tensor]  # computes the total loss and its gradient

FLAT = 1e-12  # L-BFGS ends when the largest derivative is below this, or when the loss falls by less, relative to it
PATIENCE = 5  # iterations in a row

HISTORY = 50  # pairs of steps and gradients that L-BFGS remembers


class Stage(ABC):
    """An optimiser at work.

    Attributes
    ----------
    optimizers
        What is stepped; their states are kept in checkpoints.
    full_batch
        Whether every step takes all training points.
    """

    optimizers: list[torch.optim.Optimizer]
    full_batch = False

    @abstractmethod
    def step(self, closure: Closure) -> str | None:
        """One step; the reason if there should be no other."""

    def state(self) -> list[float]:
        """What a resumed training goes on from, beside the states of the optimisers."""
        return []

    def restore(self, state: list[float]) -> None:  # noqa: B027  # most have none
        """Go on from a `state`."""

    def scale_rate(self, rate: float) -> None:
        """Set the learning rate, where there is one."""
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = rate


class FirstOrder(Stage):
    """Steps along gradients of batches."""

    def __init__(self, name: str, weights: Iterable[nn.Parameter], rule: OptimizerSettings) -> None:
        rates: dict[str, Any] = {"lr": rule.lr, "weight_decay": rule.weight_decay}
        classes: dict[str, Callable[..., torch.optim.Optimizer]] = {
            "adam": partial(torch.optim.Adam, fused=True),
            "adamw": partial(torch.optim.AdamW, fused=True),
            "nadam": torch.optim.NAdam,
        }
        if name == "muon":
            matrices = [weight for weight in weights if weight.ndim == 2]
            rest = [weight for weight in weights if weight.ndim != 2]
            # so scaled, its steps are as large as those of AdamW, and both go well with one learning rate
            muon = torch.optim.Muon(matrices, adjust_lr_fn="match_rms_adamw", **rates)
            self.optimizers = [muon, classes["adamw"](rest, **rates)]
        else:
            self.optimizers = [classes[name](weights, **rates)]

    def step(self, closure: Closure) -> str | None:
        closure()
        for optimizer in self.optimizers:
            optimizer.step()
        return None


class Lbfgs(Stage):
    """Limited-memory BFGS with a line search by the strong Wolfe conditions."""

    full_batch = True

    def __init__(self, weights: Iterable[nn.Parameter]) -> None:
        self.optimizers = [
            torch.optim.LBFGS(
                weights, max_iter=1, max_eval=25, history_size=HISTORY, line_search_fn="strong_wolfe",
                tolerance_grad=0, tolerance_change=0,
            )
        ]  # fmt: skip
        self._losses: list[float] = []

    def step(self, closure: Closure) -> str | None:
        optimizer = self.optimizers[0]
        step: Any = optimizer.step  # PyTorch's type asks for a closure that returns a number; L-BFGS takes tensors too
        self._losses = [*self._losses[-PATIENCE:], float(step(closure))]
        weights = optimizer.param_groups[0]["params"]
        steepest = max(float(weight.grad.abs().max()) for weight in weights if weight.grad is not None)
        if steepest <= FLAT:
            return f"the largest derivative of the loss is {steepest:.1e}"
        if len(self._losses) > PATIENCE and self._losses[0] - self._losses[-1] <= FLAT * abs(self._losses[0]):
            return f"the loss no longer falls ({self._losses[-1]:.3e})"
        return None

    def state(self) -> list[float]:
        return self._losses

    def restore(self, state: list[float]) -> None:
        self._losses = state

    def scale_rate(self, rate: float) -> None:
        pass


class GaussNewton(Stage):
    """Levenberg–Marquardt steps; see there."""

    full_batch = True

    def __init__(self, objective: Objective, weights: list[nn.Parameter]) -> None:
        self.optimizers = [LevenbergMarquardt(weights, objective)]

    def step(self, closure: Closure) -> str | None:
        optimizer = self.optimizers[0]
        assert isinstance(optimizer, LevenbergMarquardt)
        return None if optimizer.improve(closure) else "no step lowers the loss, however short"

    def scale_rate(self, rate: float) -> None:
        pass


def stages(objective: Objective, rule: OptimizerSettings) -> list[Stage]:
    """The stages of `rule` for the weights of the field.

    Raises
    ------
    InputError
        When an optimiser cannot work on this field.
    """
    weights = list(objective.field.parameters())
    made: list[Stage] = []
    for name in rule.stages:
        if name in FULL_BATCH and weights[0].dtype != torch.float64:
            raise InputError(
                f"optimizer.name={name} ends early in float32, whose digits hide how the loss falls: set "
                "model.dtype=float64."
            )
        if name == "lbfgs":
            made.append(Lbfgs(weights))
        elif name == "levenberg_marquardt":
            made.append(GaussNewton(objective, weights))
        else:
            made.append(FirstOrder(name, weights, rule))
    return made
