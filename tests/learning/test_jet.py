"""Closed-form derivatives against automatic differentiation and against derivatives by hand, in float64."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.activations import ACTIVATIONS, DERIVATIVES
from pgdl_lab.learning.jet import ROWS, Affine, nested, propagate
from pgdl_lab.learning.layers import fully_connected
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.needs import need
from tests.trainings import training

discover()
TOLERANCE = 1e-10


def plane(points: Tensor, order: int) -> Tensor:
    """Rows of the inputs (x, z, 0.3)."""
    rows = torch.zeros(ROWS[order], len(points), 3, dtype=torch.double)
    rows[0, :, :2], rows[0, :, 2] = points, 0.3
    if order:
        rows[1, :, 0] = rows[2, :, 1] = 1
    return rows


def by_autograd(layers: nn.Module, points: Tensor) -> Tensor:
    """All six rows, one component and one derivative at a time."""
    points = points.clone().requires_grad_()
    value = layers(torch.cat([points, torch.full_like(points[:, :1], 0.3)], dim=1))
    columns = []
    for component in value.T:
        (first,) = torch.autograd.grad(component.sum(), points, create_graph=True, materialize_grads=True)
        x, z = first.T
        second_x, second_z = (
            torch.autograd.grad(part.sum(), points, retain_graph=True, allow_unused=True)[0]
            if part.requires_grad
            else None
            for part in (x, z)
        )
        zero = torch.zeros_like(points)
        second_x, second_z = (zero if part is None else part for part in (second_x, second_z))
        columns.append(torch.stack([component, x, z, second_x[:, 0], second_z[:, 1], second_x[:, 1]]))
    return torch.stack(columns, dim=-1).detach()


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_network_agrees_with_autograd(activation: str) -> None:
    torch.manual_seed(1)
    layers = nn.Sequential(
        Affine(torch.tensor([0.1, 2.0, 1.0]), torch.tensor([0.0, 1.0, -0.5])),
        *fully_connected(3, 2, depth=3, width=16, activation=activation),
        Affine(torch.tensor([5.0, 0.2]), torch.tensor([1.0, 2.0])),
    ).double()
    points = torch.randn(7, 2, dtype=torch.double)
    expected = by_autograd(layers, points)
    for order, rows in ROWS.items():
        assert torch.allclose(propagate(layers, plane(points, order)), expected[:rows], atol=TOLERANCE, rtol=TOLERANCE)


@pytest.mark.parametrize("activation", ACTIVATIONS.values())
def test_activation_agrees_with_the_fallback(activation: type[nn.Module]) -> None:
    assert activation in DERIVATIVES
    torch.manual_seed(2)
    rows = torch.randn(6, 5, 4, dtype=torch.double)
    assert torch.allclose(propagate(activation(), rows), nested(activation(), rows), atol=TOLERANCE, rtol=TOLERANCE)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_gradients_by_hand_agree_with_the_fallback(activation: str, order: int) -> None:
    """What a loss on all derivatives sends back to the weights, with and without the derivative by hand."""
    torch.manual_seed(4)
    layers = fully_connected(3, 2, depth=2, width=8, activation=activation).double()
    rows, weights = plane(torch.randn(9, 2, dtype=torch.double), order), list(layers.parameters())
    factors = torch.randn(ROWS[order], 9, 2, dtype=torch.double)

    def gradients(outputs: Tensor) -> list[Tensor]:
        return list(torch.autograd.grad((factors * outputs.square()).sum(), weights))

    for ours, theirs in zip(gradients(propagate(layers, rows)), gradients(nested(layers, rows)), strict=True):
        assert torch.allclose(ours, theirs, atol=TOLERANCE, rtol=TOLERANCE)


def behind_another_layer() -> tuple[nn.Sequential, Tensor]:
    """A network whose linear layers see second derivatives that depend on weights before them, and its rows."""
    torch.manual_seed(6)
    layers = nn.Sequential(Mixing(), *fully_connected(2, 2, depth=3, width=8, activation="gelu")).double()
    return layers, plane(torch.randn(9, 2, dtype=torch.double), 2)


def test_two_sweeps_pass_gradients_on_to_what_is_before_them() -> None:
    layers, rows = behind_another_layer()
    factors, weights = torch.randn(6, 9, 2, dtype=torch.double), list(layers.parameters())
    ours, theirs = (
        torch.autograd.grad((factors * way(layers, rows).square()).sum(), weights) for way in (propagate, nested)
    )
    for one, other in zip(ours, theirs, strict=True):
        assert torch.allclose(one, other, atol=TOLERANCE, rtol=TOLERANCE)


def test_passes_that_are_alive_together_share_no_memory() -> None:
    layers, rows = behind_another_layer()
    weights = list(layers.parameters())
    alone = [torch.autograd.grad(propagate(layers, factor * rows).square().sum(), weights) for factor in (1.0, 2.0)]
    first, second = (propagate(layers, factor * rows).square().sum() for factor in (1.0, 2.0))
    for total, expected in ((second, alone[1]), (first, alone[0]), (first, alone[0])):
        for one, other in zip(torch.autograd.grad(total, weights, retain_graph=True), expected, strict=True):
            assert torch.equal(one, other)


def test_jacobians_by_weights_can_be_taken_of_all_rows_at_once() -> None:
    torch.manual_seed(5)
    layers = fully_connected(3, 2, depth=2, width=4, activation="tanh").double()
    rows, weights = plane(torch.randn(3, 2, dtype=torch.double), 2), dict(layers.named_parameters())

    class Carry(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layers = layers

        def forward(self, rows: Tensor) -> Tensor:
            return propagate(self.layers, rows)

    def outputs(weights: dict[str, Tensor]) -> Tensor:
        return torch.func.functional_call(Carry(), {f"layers.{k}": v for k, v in weights.items()}, (rows,))

    jacobian = torch.func.jacrev(outputs)(weights)
    (last,) = torch.autograd.grad(propagate(layers, rows)[5, 2, 1], weights["0.weight"])
    assert torch.allclose(jacobian["0.weight"][5, 2, 1], last, atol=TOLERANCE, rtol=TOLERANCE)


class Mixing(nn.Module):
    """A layer that no table knows: it mixes channels and bends them."""

    def __init__(self) -> None:
        super().__init__()
        self.mix = nn.Linear(3, 2)

    def forward(self, inputs: Tensor) -> Tensor:
        return torch.exp(self.mix(inputs) / 3) * inputs[..., :1]


def test_unknown_layer_is_differentiated_and_trains() -> None:
    torch.manual_seed(3)
    layers = nn.Sequential(nn.Linear(3, 3), nn.Tanh(), Mixing(), nn.Linear(2, 2)).double()
    points = torch.randn(6, 2, dtype=torch.double)
    rows = propagate(layers, plane(points, 2))
    assert torch.allclose(rows, by_autograd(layers, points), atol=TOLERANCE, rtol=TOLERANCE)
    rows.square().sum().backward()
    assert all(weight.grad is not None and weight.grad.abs().sum() > 0 for weight in layers.parameters())


def test_derivatives_are_physical_whatever_the_scaling(tmp_path: Path) -> None:
    """A network of one sine, scaled in and out, against its derivatives by hand."""
    model = plugin("model", "mlp")(depth=1, width=1, activation="sin", dtype="float64", interval=[0.0, 1.0])
    field = model.new_field(training(tmp_path, {"data": {}}))
    scale_in, first, _, last, scale_out = field.layers
    with torch.no_grad():
        first.weight.copy_(torch.tensor([[2.0, 3.0, 0.0]]))
        first.bias.zero_()
        last.weight.copy_(torch.tensor([[1.0], [0.0]]))
        last.bias.zero_()
    points = torch.tensor([[10.0, 5.0], [100.0, 1.0]], dtype=torch.double)
    jet = field.jet(field.coordinates(points.numpy(), 2), torch.tensor([[10.0], [20.0]], dtype=torch.double), 2)
    x_low, x_high, z_low, z_high = 0.0, 114.0, 0.0, 17.0
    amplitude = float(scale_out.scale[0])
    phase = 2 * (points[:, 0] - x_low) / (x_high - x_low) + 3 * (points[:, 1] - z_low) / (z_high - z_low)
    per_x, per_z = 2 / (x_high - x_low), 3 / (z_high - z_low)
    assert torch.allclose(jet.gradient[:, 0, 0], amplitude * per_x * phase.cos())
    assert torch.allclose(jet.gradient[:, 0, 1], amplitude * per_z * phase.cos())
    assert torch.allclose(jet.hessian[:, 0, 0], -amplitude * per_x**2 * phase.sin())
    assert torch.allclose(jet.hessian[:, 0, 1], -amplitude * per_z**2 * phase.sin())
    assert torch.allclose(jet.hessian[:, 0, 2], -amplitude * per_x * per_z * phase.sin())
    assert not jet.gradient[:, 1].any()


def test_a_compiled_training_gives_the_same_field(tmp_path: Path) -> None:
    need("g++")
    losses = {"data": {}, "navier_cauchy": {"weight": 1e-3}}
    fields: list[Surrogate] = []
    for compiled in (False, True):
        given = training(tmp_path / str(compiled), losses)
        # the learning rate follows the time, of which compiling takes much
        settings = replace(given.trainer, compile=compiled, max_epochs=2, max_time="10:00:00", validation=0.2)
        model = plugin("model", "mlp")(depth=2, width=8, activation="tanh", dtype="float64")
        fields.append(model.fit(replace(given, trainer=settings)))
    points = fields[0].domain.points_mm
    plain, fused = (field.predict(points, [10.0, 50.0]) for field in fields)
    assert np.allclose(plain, fused, atol=1e-9, rtol=1e-9)
    assert fields[1].record.history[-1]["raw/navier_cauchy"] == pytest.approx(
        fields[0].record.history[-1]["raw/navier_cauchy"], rel=1e-9
    )


@pytest.mark.parametrize("order", [1, 2])
def test_what_the_compiler_sees_of_an_activation_is_the_chain_rule(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(7)
    rows = torch.randn(ROWS[order], 5, 4, dtype=torch.double)
    eager = propagate(nn.Tanh(), rows)
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    seen = propagate(nn.Tanh(), rows)
    assert torch.allclose(seen, eager, atol=TOLERANCE, rtol=TOLERANCE)
    t, x, z = rows[0].tanh(), rows[1], rows[2]
    assert torch.allclose(seen[1], (1 - t**2) * x, atol=TOLERANCE, rtol=TOLERANCE)
    if order == 2:
        mixed = (1 - t**2) * rows[5] - 2 * t * (1 - t**2) * x * z
        assert torch.allclose(seen[5], mixed, atol=TOLERANCE, rtol=TOLERANCE)


class Constant(nn.Module):
    """What it gives has no derivative by place, with a weight or without."""

    def __init__(self, weight: bool) -> None:
        super().__init__()
        self.value = nn.Parameter(torch.ones(2, dtype=torch.double)) if weight else torch.ones(2, dtype=torch.double)

    def forward(self, inputs: Tensor) -> Tensor:
        return self.value.expand(*inputs.shape[:-1], 2)


@pytest.mark.parametrize("weight", [True, False])
@pytest.mark.parametrize("order", [1, 2])
def test_layers_that_are_constant_have_no_derivatives(weight: bool, order: int) -> None:
    rows = nested(Constant(weight), plane(torch.randn(4, 2, dtype=torch.double), order))
    assert torch.equal(rows[0], torch.ones(4, 2, dtype=torch.double)) and not rows[1:].any()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("activation", ["tanh", "silu", "gelu", "sin"])
def test_gradients_of_an_activation_against_differences(activation: str, order: int) -> None:
    """By its rows and by the bias before it, which the shorter way of networks of few outputs does not ask for."""
    torch.manual_seed(8)
    rows = torch.randn(ROWS[order], 3, 2, dtype=torch.double, requires_grad=True)
    bias = torch.randn(2, dtype=torch.double, requires_grad=True)
    layers = nn.Sequential(nn.Linear(2, 2), ACTIVATIONS[activation]()).double()  # ends with no linear layer

    def through(rows: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        return torch.func.functional_call(Carried(layers), {"layers.0.weight": weight, "layers.0.bias": bias}, rows)

    weight = layers[0].weight.detach().clone().requires_grad_()
    assert torch.autograd.gradcheck(through, (rows, weight, bias), eps=1e-5, atol=1e-7, check_undefined_grad=False)


class Carried(nn.Module):
    """`propagate` as a module, so that its weights can be given."""

    def __init__(self, layers: nn.Module) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, rows: Tensor) -> Tensor:
        return propagate(self.layers, rows)
