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


def _relu(h: Tensor) -> Derivatives:
    step = (h > 0).to(h.dtype)
    zero = torch.zeros_like(h)
    return h * step, step, zero, zero


def _tanh(h: Tensor) -> Derivatives:
    value = (2 * torch.sigmoid(2 * h)).sub_(1)  # the same, several times faster than torch.tanh
    first = torch.square(value).neg_().add_(1)
    second = (value * first).mul_(-2)
    return value, first, second, torch.square(first).addcmul_(value, second).mul_(-2)


def _silu(h: Tensor) -> Derivatives:
    gate = torch.sigmoid(h)
    slope = torch.addcmul(gate, gate, gate, value=-1)
    odd = (-2 * gate).add_(1)
    bend = slope * odd
    third = (h * torch.square(slope).mul_(-2).addcmul_(bend, odd)).add_(bend, alpha=3)
    return h * gate, torch.addcmul(gate, h, slope), (2 * slope).addcmul_(h, bend), third


def _gelu(h: Tensor) -> Derivatives:
    gate = torch.erf(h * math.sqrt(0.5)).add_(1).mul_(0.5)
    square = torch.square(h)
    density = torch.exp(square * -0.5) / math.sqrt(2 * math.pi)
    return h * gate, torch.addcmul(gate, h, density), density * (2 - square), density * h * (square - 4)


def _softplus(h: Tensor) -> Derivatives:
    gate = torch.sigmoid(h)
    slope = gate * (1 - gate)
    return nn.functional.softplus(h), gate, slope, slope * (1 - 2 * gate)


def _sine(h: Tensor) -> Derivatives:
    value, first = torch.sin(h), torch.cos(h)
    return value, first, -value, -first


DERIVATIVES: dict[type[nn.Module], Callable[[Tensor], Derivatives]] = {
    nn.ReLU: _relu,
    nn.Tanh: _tanh,
    nn.SiLU: _silu,
    nn.GELU: _gelu,
    nn.Softplus: _softplus,
    Sine: _sine,
}
"""Value and first three derivatives; the third is for the gradient of a loss that holds second derivatives."""
