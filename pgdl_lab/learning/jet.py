"""Values and spatial derivatives of a field, propagated through its layers in closed form.

A stack of rows [h, h_x, h_z, h_xx, h_zz, h_xz] is carried through every layer: one matrix product per linear layer, the
chain rule at every activation (Faà di Bruno to second order). One ordinary backward pass follows. Networks of one or
two outputs take a shorter way, see `pgdl_lab.learning.sweeps`. Layers that are not known here are differentiated by
nested automatic differentiation, one layer at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from pgdl_lab.learning.activations import DERIVATIVES
from pgdl_lab.learning.sweeps import MOST_OUTPUTS, traced_sweeps, two_sweeps

ROWS = {0: 1, 1: 3, 2: 6}  # number of rows by order of the highest derivative
X, Z, XX, ZZ, XZ = range(1, 6)


@dataclass(frozen=True)
class Jet:
    """A displacement field and its derivatives at n points.

    Attributes
    ----------
    rows
        (J, n, 2) with J = 1, 3 or 6: u [mm], u_x, u_z [–], u_xx, u_zz, u_xz [1/mm].
    pressures_kpa
        (n,), the first input at each point, as a rule the pressure [kPa]; None where no term asks for it.
    """

    rows: Tensor
    pressures_kpa: Tensor | None = None

    @property
    def value(self) -> Tensor:
        """(n, 2), displacement [mm]."""
        return self.rows[0]

    @property
    def gradient(self) -> Tensor:
        """(n, 2, 2), ∂u_i/∂x_j [–] for component i and direction j, both in the order x, z."""
        return self.rows[X : Z + 1].permute(1, 2, 0)

    @property
    def hessian(self) -> Tensor:
        """(n, 2, 3), second derivatives of component i in the order xx, zz, xz [1/mm]."""
        return self.rows[XX:].permute(1, 2, 0)


class Affine(nn.Module):
    """h · scale + shift with fixed vectors, the scaling of inputs and outputs.

    Parameters
    ----------
    scale, shift
        (C,) each.
    """

    scale: Tensor
    shift: Tensor

    def __init__(self, scale: Tensor, shift: Tensor) -> None:
        super().__init__()
        self.register_buffer("scale", scale)
        self.register_buffer("shift", shift)

    def forward(self, inputs: Tensor) -> Tensor:
        return inputs * self.scale + self.shift


class _Activation(torch.autograd.Function):
    """The chain rule at an activation s, and its derivative by hand, which passes over the rows less often.

    With h the first row: s(h); s' h_i; s'' h_i h_j + s' h_ij.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(rows: Tensor, bias: Tensor, kind: type[nn.Module]) -> tuple[Tensor, ...]:
        value, first, second, third = DERIVATIVES[kind](rows[0] + bias)
        out = first * rows
        out[0] = value
        if len(rows) == ROWS[2]:
            bent = second * rows[X : Z + 1]
            out[XX : ZZ + 1] += bent * rows[X : Z + 1]
            out[XZ] += bent[0] * rows[Z]
        return out, first, second, third

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.save_for_backward(inputs[0], *output[1:])
        ctx.mark_non_differentiable(*output[1:])
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, None]:
        rows, first, second, third = ctx.saved_tensors
        g = grads[0]
        given = first * g
        given[0] += second * (g[1:] * rows[1:]).sum(dim=0)
        if len(rows) == ROWS[2]:
            x, z = rows[X], rows[Z]
            along_x = 2 * x * g[XX] + z * g[XZ]
            along_z = 2 * z * g[ZZ] + x * g[XZ]
            given[X] += second * along_x
            given[Z] += second * along_z
            given[0] += third * (x * along_x + z * along_z) / 2
        return given, given[0].sum(dim=0), None


def propagate(layer: nn.Module, rows: Tensor) -> Tensor:
    """Carry rows (J, n, C) through `layer`, giving (J, n, C')."""
    if isinstance(layer, nn.Sequential):
        return _through(list(layer), rows)
    if len(rows) == 1:
        return layer(rows)
    if isinstance(layer, nn.Linear):
        # the bias belongs to the value alone
        return torch.cat([layer(rows[:1]), nn.functional.linear(rows[1:], layer.weight)])
    if isinstance(layer, Affine):
        return torch.cat([layer(rows[:1]), rows[1:] * layer.scale])
    if type(layer) in DERIVATIVES:
        return _activated(rows, rows.new_zeros(rows.shape[-1]), type(layer))
    return nested(layer, rows)


def _through(layers: list[nn.Module], rows: Tensor) -> Tensor:
    """Carry rows through one layer after the other; a linear layer and its activation share one pass."""
    while layers:
        if len(rows) == ROWS[2] and (length := _few_outputs(layers)) and not _transformed():
            chain, layers = layers[:length], layers[length:]
            linear = [layer for layer in chain if isinstance(layer, nn.Linear)]
            # the compiler does not see through a derivative by hand
            sweeps = traced_sweeps if torch.compiler.is_compiling() else two_sweeps
            rows = sweeps(linear, [type(layer) for layer in chain[1::2]], rows)
            continue
        layer, *layers = layers
        if len(rows) > 1 and isinstance(layer, nn.Linear) and layers and type(layers[0]) in DERIVATIVES:
            bias = rows.new_zeros(layer.out_features) if layer.bias is None else layer.bias
            rows = _activated(nn.functional.linear(rows, layer.weight), bias, type(layers[0]))
            layers = layers[1:]
        else:
            rows = propagate(layer, rows)
    return rows


def _few_outputs(layers: list[nn.Module]) -> int:
    """How many of `layers`, from the first, are linear ones with activations between, down to few outputs; or 0."""
    length = 0
    while (
        length + 2 < len(layers) and isinstance(layers[length], nn.Linear) and type(layers[length + 1]) in DERIVATIVES
    ):
        length += 2
    last = layers[length]
    return length + 1 if length and isinstance(last, nn.Linear) and last.out_features <= MOST_OUTPUTS else 0


def _transformed() -> bool:
    """Whether PyTorch transforms what it is shown, and cannot look into derivatives by hand in place."""
    return not torch.compiler.is_compiling() and torch._C._are_functorch_transforms_active()


def _activated(rows: Tensor, bias: Tensor, kind: type[nn.Module]) -> Tensor:
    """The chain rule at an activation of rows (J, n, C) plus a bias (C,) of the first."""
    if not torch.compiler.is_compiling():
        apply: Any = _Activation.apply
        out: Tensor = apply(rows, bias, kind)[0]
        return out
    # the compiler fuses this and its derivative by itself, and does not see through a derivative by hand
    value, first, second, _ = DERIVATIVES[kind](rows[0] + bias)
    stack = [value, first * rows[X], first * rows[Z]]
    if len(rows) == ROWS[2]:
        pairs = ((XX, X, X), (ZZ, Z, Z), (XZ, X, Z))
        stack += [second * rows[i] * rows[j] + first * rows[ij] for ij, i, j in pairs]
    return torch.stack(stack)


def nested(layer: nn.Module, rows: Tensor) -> Tensor:
    """Carry rows (J, n, C) through any twice differentiable layer by automatic differentiation.

    The inputs are written as the second-order Taylor polynomial of the rows in two small offsets (a, b) along x and z,
    whose derivatives at zero are those of the layer's outputs.
    """
    with torch.enable_grad():
        offsets = torch.zeros(*rows.shape[1:-1], 2, dtype=rows.dtype, device=rows.device, requires_grad=True)
        a, b = offsets[..., :1], offsets[..., 1:]
        inputs = rows[0] + a * rows[X] + b * rows[Z]
        if len(rows) == ROWS[2]:
            inputs = inputs + a**2 / 2 * rows[XX] + b**2 / 2 * rows[ZZ] + a * b * rows[XZ]
        value = layer(inputs)
        along_x, along_z = _along(value, offsets)
        stack = [value, along_x, along_z]
        if len(rows) == ROWS[2]:
            (xx, xz), (_, zz) = _along(along_x, offsets), _along(along_z, offsets)
            stack += [xx, zz, xz]
        return torch.stack(stack)


def _along(outputs: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Derivatives of outputs (n, C) by the two offsets (n, 2), each (n, C).

    Two reverse passes make a forward one: the gradient of vᵀ·outputs is linear in v, and its derivative by v is wanted.
    """
    probe = torch.ones_like(outputs, requires_grad=True)
    if not outputs.requires_grad:
        return torch.zeros_like(outputs), torch.zeros_like(outputs)
    (pulled,) = torch.autograd.grad(outputs, offsets, probe, create_graph=True, materialize_grads=True)
    if not pulled.requires_grad:
        return torch.zeros_like(outputs), torch.zeros_like(outputs)
    along_x, along_z = (
        torch.autograd.grad(pulled[..., i].sum(), probe, create_graph=True, materialize_grads=True)[0] for i in range(2)
    )
    return along_x, along_z
