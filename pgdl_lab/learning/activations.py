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
    value = torch.tanh(h)
    first = 1 - value.square()
    second = -2 * value * first
    return value, first, second, -2 * (first.square() + value * second)


def _silu(h: Tensor) -> Derivatives:
    gate = torch.sigmoid(h)
    slope, odd = gate * (1 - gate), 1 - 2 * gate
    bend = slope * odd
    return h * gate, gate + h * slope, 2 * slope + h * bend, 3 * bend + h * (bend * odd - 2 * slope.square())


def _gelu(h: Tensor) -> Derivatives:
    gate = (1 + torch.erf(h / math.sqrt(2))) / 2
    density = torch.exp(-h.square() / 2) / math.sqrt(2 * math.pi)
    return h * gate, gate + h * density, density * (2 - h.square()), density * h * (h.square() - 4)


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
