"""Fully connected layers."""

from __future__ import annotations

import torch
from torch import nn

from pgdl_lab.learning.activations import ACTIVATIONS

DTYPES = {"float32": torch.float32, "float64": torch.float64}


def fully_connected(inputs: int, outputs: int, depth: int, width: int, activation: str) -> nn.Sequential:
    """`depth` hidden layers of `width` neurons between `inputs` and `outputs`; PyTorch's initial weights."""
    layers: list[nn.Module] = []
    for _ in range(depth):
        layers += [nn.Linear(inputs, width), ACTIVATIONS[activation]()]
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))
