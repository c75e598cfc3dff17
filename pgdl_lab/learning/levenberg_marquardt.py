"""Levenberg–Marquardt for small networks."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.func import functional_call, jacrev, vmap

from pgdl_lab.core.errors import InputError
from pgdl_lab.learning.objective import Objective

MOST_WEIGHTS = 4000  # the normal matrix of more takes longer than a thousand steps of a first-order method
POINTS = 8192  # training points that the curvature is taken from; the gradient is always that of all
CHUNK = 1024  # points whose Jacobian is held at once
TRIALS = 10  # dampings that are tried in one step
FIRST, LOWER, RAISE, LEAST = 1e-2, 0.3, 4.0, 1e-12


class LevenbergMarquardt(torch.optim.Optimizer):
    """Damped Gauss–Newton steps: (H + μ diag H) s = −g, the damping μ following from what each step gains.

    g is the gradient of the total loss. H = 2/n Σ JᵀJ is the Gauss–Newton curvature of the data term alone, with J the
    derivative of the displacement at a training point by the weights: for other terms the steps are still downhill, and
    what is accepted lowers the total (J. Moré, The Levenberg–Marquardt algorithm, 1978).

    Parameters
    ----------
    weights
        All weights of the field.
    objective
        What is minimised.

    Raises
    ------
    InputError
        When there are more weights than a dense matrix can hold in useful time.
    """

    def __init__(self, weights: list[nn.Parameter], objective: Objective) -> None:
        count = sum(weight.numel() for weight in weights)
        if count > MOST_WEIGHTS:
            raise InputError(
                f"optimizer.name=levenberg_marquardt takes at most {MOST_WEIGHTS} weights, and this network has "
                f"{count}: lower model.width or model.depth, or choose lbfgs."
            )
        super().__init__(weights, {"damping": FIRST})
        self._objective = objective

    def improve(self, closure: Callable[[], Tensor]) -> bool:
        """One step; whether any lowered the loss."""
        group = self.param_groups[0]
        weights = group["params"]
        before = float(closure())
        slope = torch.cat([torch.zeros_like(w).flatten() if w.grad is None else w.grad.flatten() for w in weights])
        curvature = self._curvature()
        diagonal = curvature.diagonal().clone()
        diagonal += 1e-9 * diagonal.mean() + torch.finfo(diagonal.dtype).tiny
        start = [weight.detach().clone() for weight in weights]
        for _ in range(TRIALS):
            factor, failed = torch.linalg.cholesky_ex(curvature + torch.diag(group["damping"] * diagonal))
            if not failed:
                step = torch.cholesky_solve(-slope[:, None], factor)[:, 0]
                self._move(start, step)
                after = float(closure())
                if after < before:
                    group["damping"] = max(LOWER * group["damping"], LEAST)
                    return True
            group["damping"] *= RAISE
        self._move(start, torch.zeros_like(slope))
        return False

    @torch.no_grad()
    def _move(self, start: list[Tensor], step: Tensor) -> None:
        weights = self.param_groups[0]["params"]
        parts = torch.split(step, [weight.numel() for weight in weights])
        for weight, origin, part in zip(weights, start, parts, strict=True):
            weight.copy_(origin + part.view_as(weight))

    @torch.no_grad()
    def _curvature(self) -> Tensor:
        """Gauss–Newton matrix (W, W) of the data term."""
        objective = self._objective
        names = [name for name, _ in objective.field.named_parameters()]
        weights = dict(objective.field.named_parameters())
        buffers = dict(objective.field.named_buffers())

        def displacement(values: dict[str, Tensor], inputs: Tensor, case: Tensor) -> Tensor:
            return functional_call(objective.field, {**buffers, **values}, (inputs[None, None], case[None]))[0]

        jacobian = vmap(jacrev(displacement), in_dims=(None, 0, 0))
        chosen = torch.arange(0, len(objective.cases), max(1, len(objective.cases) // POINTS))
        count = sum(weight.numel() for weight in weights.values())
        total = torch.zeros(count, count, dtype=objective.cases.dtype, device=objective.cases.device)
        for part in torch.split(chosen.to(total.device), CHUNK):
            rows = jacobian(weights, objective.inputs[0, part], objective.cases[part])
            flat = torch.cat([rows[name].flatten(2) for name in names], dim=2).flatten(0, 1)
            total.addmm_(flat.T, flat)
        weight = objective.weight("data") if "data" in objective.losses else 1.0
        return total * (2 * weight / len(chosen))
