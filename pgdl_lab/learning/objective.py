"""The total loss of a field: its terms, evaluated on shared jets."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import PRESSURE
from pgdl_lab.learning.activations import PIECEWISE_LINEAR
from pgdl_lab.learning.balancing import Balancer, BalancingSettings
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.field import Field
from pgdl_lab.learning.jet import Jet
from pgdl_lab.learning.loss import Loss, PhysicsLoss
from pgdl_lab.learning.scene import Scene

_log = logging.getLogger(__name__)

ROUNDING = 1e-9  # pressures are sums and products of floats


class Objective(nn.Module):
    """The weighted sum of loss terms over batches of training points.

    All data lie in memory, on the device of the field, and a batch is a slice of them.

    Parameters
    ----------
    field
        The field that is trained.
    losses
        Terms by name.
    samples, scene
        Training points and body.
    balancing
        How the weights of the terms follow the training.
    compiled
        Whether the field's derivatives are compiled.

    Raises
    ------
    InputError
        When there is no term, or one of physics where the pressure is not the only input.
    """

    inputs: Tensor
    cases: Tensor
    targets: Tensor

    def __init__(
        self,
        field: Field,
        losses: Mapping[str, Loss],
        samples: Samples,
        scene: Scene,
        balancing: BalancingSettings,
        compiled: bool = False,
    ) -> None:
        super().__init__()
        if not losses:
            raise InputError("loss=[] leaves nothing to minimise; give at least one, such as loss=[data].")
        self.field = field
        self._jet = _compiled(field.jet) if compiled else field.jet
        self.losses = dict(losses)
        self.scene = scene
        self.balancer = Balancer(balancing, self.losses)
        own = {name: given for name, loss in self.losses.items() if (given := loss.own_points(scene)) is not None}
        for name, loss in losses.items():
            if isinstance(loss, PhysicsLoss) and samples.cases.names != [PRESSURE]:
                raise InputError(
                    f"Loss {name} knows no other input than the pressure, and the data have "
                    f"{', '.join(samples.cases.names)}: leave it out."
                )
        self.ranges = list(samples.cases.ranges().values())
        self.range_kpa = self.ranges[0][0], self.ranges[0][1]
        self.interest_kpa = max(self.range_kpa[1], scene.max_kpa)
        extrapolates = self.interest_kpa > (1 + ROUNDING) * self.range_kpa[1]
        self.free = {
            name
            for name, loss in self.losses.items()
            if extrapolates and name not in own and isinstance(loss, PhysicsLoss) and loss.beyond
        }

        def order(names: Iterable[str]) -> int:
            return max((self.losses[name].order for name in names), default=0)

        self.order, self.free_order = order(self.losses.keys() - own.keys() - self.free), order(self.free)
        self._keep("inputs", field.coordinates(samples.points_mm, max(self.order, self.free_order)))
        self._keep("cases", torch.from_numpy(samples.cases.values))
        self._keep("targets", torch.from_numpy(samples.displacements_mm))
        for name, (own_points, targets) in own.items():
            self._keep(f"{name}_inputs", field.coordinates(own_points, self.losses[name].order))
            self._keep(f"{name}_targets", torch.from_numpy(targets))
        self.own = tuple(own)
        self._warn_of_lost_curvature()

    def _keep(self, name: str, data: Tensor) -> None:
        dtype = next(self.field.parameters()).dtype
        self.register_buffer(name, data.to(dtype), persistent=False)

    def _warn_of_lost_curvature(self) -> None:
        flat = {type(layer).__name__ for layer in self.field.modules() if isinstance(layer, PIECEWISE_LINEAR)}
        for name, loss in self.losses.items():
            if flat and loss.order >= 2:
                _log.warning(
                    "Loss %s uses second derivatives, which are zero everywhere in a network of %s: they train "
                    "nothing, only first derivatives in it do; choose model.activation=tanh, silu, gelu or sin.",
                    name, " and ".join(sorted(flat)),
                )  # fmt: skip

    def terms(self, batch: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
        """Unweighted terms at the training points `batch` (n,); `generator` draws the cases that are not theirs."""
        buffers = dict(self.named_buffers(recurse=False))

        def drawn(count: int, loss: Loss | None = None) -> Tensor:
            low, high = self.range_kpa
            if not isinstance(loss, PhysicsLoss) or loss.beyond:
                high = self.interest_kpa
            several = 1 if loss is not None and loss.one_pressure else count
            columns = [low + (high - low) * torch.rand(several, generator=generator)]
            columns += [least + (most - least) * torch.rand(several, generator=generator)
                        for least, most in self.ranges[1:]]  # fmt: skip
            return torch.stack(columns, dim=1).to(self.cases).expand(count, -1)

        inputs, targets = self.inputs[:, batch], self.targets[batch]
        jet = self._jet(inputs, self.cases[batch], self.order)
        if self.free:
            free_jet = self._jet(inputs, drawn(len(batch)), self.free_order)
        values = {}
        for name, loss in self.losses.items():
            if name in self.own:
                own_inputs, own_targets = buffers[f"{name}_inputs"], buffers[f"{name}_targets"]
                own_jet = self._jet(own_inputs, drawn(len(own_targets), loss), loss.order)
                values[name] = loss.value(own_jet, own_targets, self.scene)
            elif name in self.free:
                values[name] = loss.value(free_jet, torch.full_like(targets, torch.nan), self.scene)
            else:
                values[name] = loss.value(jet, targets, self.scene)
        return values

    def weight(self, name: str) -> float:
        """What the term `name` counts at present: its weight times its factor."""
        return self.losses[name].weight * self.balancer.factors[name]

    def total(self, terms: Mapping[str, Tensor]) -> Tensor:
        """Weighted sum of the terms."""
        return torch.stack([self.weight(name) * value for name, value in terms.items()]).sum()

    def balance(self, terms: Mapping[str, Tensor], generator: torch.Generator) -> None:
        """Adjust the factors of the weights by the present terms."""
        if self.balancer.settings.rule == "gradient_norm":
            self.balancer.by_gradients(self.gradient_norms(terms))
        else:
            draw = float(torch.rand((), generator=generator))
            self.balancer.by_progress({name: float(value.detach()) for name, value in terms.items()}, draw)

    def gradient_norms(self, terms: Mapping[str, Tensor]) -> dict[str, float]:
        """Norm of each unweighted term's gradient by the weights of the field."""
        weights = [weight for weight in self.field.parameters() if weight.requires_grad]
        norms = {}
        for name, value in terms.items():
            gradients = (
                torch.autograd.grad(value, weights, retain_graph=True, allow_unused=True) if value.requires_grad else ()
            )
            norms[name] = sum(float(gradient.square().sum()) for gradient in gradients if gradient is not None) ** 0.5
        return norms

    def gradient_shares(self, terms: Mapping[str, Tensor]) -> dict[str, float]:
        """Norm of each weighted term's gradient by the weights, as a share of the sum of these norms."""
        norms = {name: self.weight(name) * norm for name, norm in self.gradient_norms(terms).items()}
        whole = sum(norms.values())
        return {name: norm / whole if whole else 0.0 for name, norm in norms.items()}


def _compiled(jet: Callable[..., Jet]) -> Callable[..., Jet]:
    """`jet` compiled, so that the gradients of terms that share one can be taken one by one."""
    functorch: Any = importlib.import_module("torch._functorch.config")
    functorch.donated_buffer = False
    return torch.compile(jet)
