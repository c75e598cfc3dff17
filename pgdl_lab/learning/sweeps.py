"""Values and derivatives of a network with few outputs: one sweep up its layers and one down.

With a_l = s(z_l) the activations of layer l and z_l = W_l a_{l−1} + b_l,

    ∂²u/∂x_i∂x_j = Σ_l (∂u/∂a_l) · (s''(z_l) ∂_i z_l ∂_j z_l) + (∂u/∂a_0) · ∂_i∂_j a_0,

so that second derivatives need no rows of their own: the sweep up carries a, ∂_x a and ∂_z a, the sweep down ∂u/∂a, one
row for each output. That is 3 + C rows in place of 6 for C outputs, and as much less in the gradients by the weights,
which are written by hand: one sweep up for what follows from ∂u/∂a, one down for what follows from a and its slopes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from pgdl_lab.learning.activations import DERIVATIVES
from pgdl_lab.learning.arena import Arena

MOST_OUTPUTS = 2  # of more, six rows through all layers cost no more


def two_sweeps(linear: Sequence[nn.Linear], kinds: Sequence[type[nn.Module]], rows: Tensor) -> Tensor:
    """Carry rows (6, n, F), see `Jet`, through linear layers with an activation after each but the last: (6, n, C)."""
    weights = [layer.weight for layer in linear]
    biases = [rows.new_zeros(len(layer.weight)) if layer.bias is None else layer.bias for layer in linear]
    apply: Any = TwoSweeps.apply
    out: Tensor = apply(rows, tuple(kinds), *weights, *biases)
    return out


def _flat(rows: Tensor) -> Tensor:
    """(J, n, C) as a matrix (J n, C)."""
    return rows.reshape(-1, rows.shape[-1])


def _times(rows: Tensor, matrix: Tensor, out: Tensor) -> Tensor:
    """(J, n, C) times (C, C'), into `out` (J, n, C')."""
    torch.mm(_flat(rows), matrix, out=out.view(-1, out.shape[-1]))
    return out


class TwoSweeps(torch.autograd.Function):
    """Forward and backward of `two_sweeps`, for weights (L + 1 tensors) and biases (as many)."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, kinds: tuple[type[nn.Module], ...], *layers: Tensor) -> Tensor:
        count, points = len(kinds), rows.shape[1]
        weights, biases = layers[: count + 1], layers[count + 1 :]
        outputs = len(weights[-1])
        arena = Arena(rows)
        up, bends = [rows[:3]], []
        for kind, weight, bias in zip(kinds, weights[:-1], biases[:-1], strict=True):
            z = _times(up[-1], weight.T, arena.take(3, points, len(weight)))
            z[0] += bias
            a, (first, second, third) = arena.take(*z.shape), arena.take(*z.shape)
            DERIVATIVES[kind](z[0], (a[0], first, second, third))
            torch.mul(z[1:], first, out=a[1:])
            up.append(a)
            bends.append((z, first, second, third))
        out = rows.new_empty(6, points, outputs)
        _times(up[-1], weights[-1].T, out[:3])
        out[0] += biases[-1]
        curved = rows.new_zeros(3, outputs, points)
        slope = weights[-1].detach()[:, None].expand(-1, points, -1)  # ∂u/∂a (C, n, w)
        down = []
        for (z, first, second, _), weight in zip(reversed(bends), reversed(weights[:-1]), strict=True):
            shape = outputs, points, len(weight)
            through = torch.mul(slope, first, out=arena.take(*shape))
            bent = torch.mul(slope, second, out=arena.take(*shape))
            down.append((slope, through, bent))
            with arena.scratch():
                along_x, along_z, product = (arena.take(*shape) for _ in range(3))
                torch.mul(bent, z[1], out=along_x)
                torch.mul(bent, z[2], out=along_z)
                for row, along, by in ((0, along_x, z[1]), (1, along_z, z[2]), (2, along_x, z[2])):
                    curved[row] += torch.mul(along, by, out=product).sum(dim=-1)
            slope = _times(through, weight, arena.take(outputs, points, weight.shape[1]))
        out[3:] = curved.transpose(1, 2) + torch.einsum("cnf,jnf->jnc", slope, rows[3:])
        ctx.save_for_backward(rows, *weights)
        ctx.swept, ctx.arena = (up, bends, down[::-1], slope), arena
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        rows, *weights = ctx.saved_tensors
        (up, bends, down, at_inputs), arena = ctx.swept, Arena(rows)
        (g,) = grads
        points, outputs = g.shape[1:]
        xx, zz, xz = g[3:].transpose(1, 2).unsqueeze(-1)  # (C, n, 1) each
        # up again: what follows from the sweep down
        by_slope = xx * rows[3] + zz * rows[4] + xz * rows[5]
        by_weights, by_z = [], []
        for (z, first, second, third), (slope, through, bent), weight in zip(bends, down, weights[:-1], strict=True):
            by_weights.append(_flat(through).T @ _flat(by_slope))
            shape = outputs, points, len(weight)
            given, by_through = arena.take(*z.shape), arena.take(*shape)
            _times(by_slope, weight.T, by_through)
            with arena.scratch():
                along_x, along_z, twice, product = (arena.take(*shape) for _ in range(4))
                torch.mul(2 * xx, z[1], out=along_x).addcmul_(xz, z[2])
                torch.mul(2 * zz, z[2], out=along_z).addcmul_(xz, z[1])
                # twice the quadratic form of z_x and z_z with the matrix that g is
                torch.mul(along_x, z[1], out=twice).addcmul_(along_z, z[2])
                torch.mul(second, torch.mul(slope, by_through, out=product).sum(dim=0), out=given[0])
                given[0].addcmul_(third, torch.mul(slope, twice, out=product).sum(dim=0), value=0.5)
                torch.sum(along_x.mul_(bent), dim=0, out=given[1])
                torch.sum(along_z.mul_(bent), dim=0, out=given[2])
                by_slope = by_through.mul_(first).addcmul_(second, twice, value=0.5)
            by_z.append(given)
        by_weights.append(by_slope.sum(dim=1))
        # down again: what follows from the sweep up
        by_weights[-1].addmm_(_flat(g[:3]).T, _flat(up[-1]))
        by_biases = [g[0].sum(dim=0)]
        by_a = _times(g[:3], weights[-1], arena.take(*up[-1].shape))
        for level in reversed(range(len(bends))):
            z, first, second, _ = bends[level]
            given = by_z[level].addcmul_(first, by_a)
            with arena.scratch():
                mixed = torch.mul(by_a[1], z[1], out=arena.take(*first.shape)).addcmul_(by_a[2], z[2])
                given[0].addcmul_(second, mixed)
            by_weights[level].addmm_(_flat(given).T, _flat(up[level]))
            by_biases.append(given[0].sum(dim=0))
            if level or ctx.needs_input_grad[0]:
                by_a = _times(given, weights[level], arena.take(*up[level].shape))
        by_rows = None
        if ctx.needs_input_grad[0]:
            by_rows = torch.cat([by_a, torch.einsum("jnc,cnf->jnf", g[3:], at_inputs)])
        return by_rows, None, *by_weights, *reversed(by_biases)
