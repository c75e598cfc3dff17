"""Activations with their first three derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn


class Sine(nn.Module):
    """sin(h) (V. Sitzmann et al., Implicit neural representations with periodic activation functions, 2020)."""

    def forward(self, inputs: Tensor) -> Tensor:
        return torch.sin(inputs)


ACTIVATIONS: dict[str, type[nn.Module]] = {
    "relu": nn.ReLU,
    "tanh": nn.Tanh,
    "silu": nn.SiLU,
    "gelu": nn.GELU,
    "softplus": nn.Softplus,
    "sin": Sine,
}
PIECEWISE_LINEAR = (nn.ReLU,)  # their second derivative is zero wherever it exists

Derivatives = tuple[Tensor, Tensor, Tensor, Tensor]
Places = tuple[Tensor | None, Tensor | None, Tensor | None, Tensor | None]  # where they go; None: into new tensors

NEW: Places = (None, None, None, None)


def _relu(h: Tensor, to: Places = NEW) -> Derivatives:
    step = torch.sign(torch.relu(h), out=to[1])
    zeros = torch.mul(h, 0, out=to[2]), torch.mul(h, 0, out=to[3])
    return torch.mul(h, step, out=to[0]), step, *zeros


def _tanh(h: Tensor, to: Places = NEW) -> Derivatives:
    one, four, zero = h.new_ones(()), h.new_full((), 4), h.new_zeros(())
    value = torch.tanh(h, out=to[0])
    first = torch.addcmul(one, value, value, value=-1, out=to[1])
    second = torch.addcmul(zero, value, first, value=-2, out=to[2])
    return value, first, second, torch.add(four, first, alpha=-6, out=to[3]).mul_(first)


def _silu(h: Tensor, to: Places = NEW) -> Derivatives:
    gate = torch.sigmoid(h)
    slope = torch.addcmul(gate, gate, gate, value=-1)
    odd = torch.mul(gate, -2).add_(1)
    bend = torch.mul(slope, odd)
    first = torch.addcmul(gate, h, slope, out=to[1])
    second = torch.mul(slope, 2, out=to[2]).addcmul_(h, bend)
    third = torch.mul(torch.mul(slope, slope).mul_(-2).addcmul_(bend, odd), h, out=to[3]).add_(bend, alpha=3)
    return torch.mul(h, gate, out=to[0]), first, second, third


def _gelu(h: Tensor, to: Places = NEW) -> Derivatives:
    gate = torch.erf(h * math.sqrt(0.5)).add_(1).mul_(0.5)
    square = torch.mul(h, h)
    density = torch.exp(square * -0.5) / math.sqrt(2 * math.pi)
    first = torch.addcmul(gate, h, density, out=to[1])
    second = torch.mul(density, 2 - square, out=to[2])
    return torch.mul(h, gate, out=to[0]), first, second, torch.mul(density * h, square - 4, out=to[3])


def _softplus(h: Tensor, to: Places = NEW) -> Derivatives:
    gate = torch.sigmoid(h, out=to[1])
    slope = torch.addcmul(gate, gate, gate, value=-1, out=to[2])
    third = torch.mul(slope, 1 - 2 * gate, out=to[3])
    return torch.add(nn.functional.softplus(h), 0, out=to[0]), gate, slope, third


def _sine(h: Tensor, to: Places = NEW) -> Derivatives:
    value, first = torch.sin(h, out=to[0]), torch.cos(h, out=to[1])
    return value, first, torch.neg(value, out=to[2]), torch.neg(first, out=to[3])


DERIVATIVES: dict[type[nn.Module], Callable[..., Derivatives]] = {
    nn.ReLU: _relu,
    nn.Tanh: _tanh,
    nn.SiLU: _silu,
    nn.GELU: _gelu,
    nn.Softplus: _softplus,
    Sine: _sine,
}
"""Value and first three derivatives; the third is for the gradient of a loss that holds second derivatives."""
