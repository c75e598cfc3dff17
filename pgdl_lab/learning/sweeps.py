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


def traced_sweeps(linear: Sequence[nn.Linear], kinds: Sequence[type[nn.Module]], rows: Tensor) -> Tensor:
    """`two_sweeps` for PyTorch's compiler, which derives its gradient and fuses what lies between matrix products."""
    points, along = rows.shape[1], rows[:3]
    bends = []
    for layer, kind in zip(linear, kinds, strict=False):
        z = along @ layer.weight.T
        value, first, second, _ = DERIVATIVES[kind](z[0] if layer.bias is None else z[0] + layer.bias)
        along = torch.stack([value, z[1] * first, z[2] * first])
        bends.append((z[1], z[2], first, second))
    last = linear[-1]
    top = along @ last.weight.T
    slope = last.weight[:, None].expand(-1, points, -1)
    curved = rows.new_zeros(3, points, len(last.weight))
    for (x, z, first, second), layer in zip(reversed(bends), reversed(linear[:-1]), strict=True):
        bent = slope * second
        curved = curved + torch.stack([(bent * pair).sum(dim=-1).T for pair in (x * x, z * z, x * z)])
        slope = (slope * first) @ layer.weight
    curved = curved + torch.einsum("cnf,jnf->jnc", slope, rows[3:])
    value = top[:1] if last.bias is None else top[:1] + last.bias
    return torch.cat([value, top[1:], curved])


def _flat(rows: Tensor) -> Tensor:
    """(J, n, C) as a matrix (J n, C)."""
    return rows.reshape(-1, rows.shape[-1])


def _times(rows: Tensor, matrix: Tensor, out: Tensor) -> Tensor:
    """(J, n, C) times (C, C'), into `out` (J, n, C')."""
    torch.mm(_flat(rows), matrix, out=out.view(-1, out.shape[-1]))
    return out


def _contracted(left: Tensor, right: Tensor, out: Tensor) -> Tensor:
    """Σ_c left[c] · right[c], into `out`; a sum over the first axis after a product takes several times as long."""
    torch.mul(left[0], right[0], out=out)
    for first, second in zip(left[1:], right[1:], strict=True):
        out.addcmul_(first, second)
    return out


def _pairs(along: Tensor, arena: Arena) -> Tensor:
    """z_x², z_z² and z_x z_z (3, n, w) from z_x and z_z (2, n, w)."""
    pairs = arena.take(3, *along.shape[1:])
    torch.mul(along, along, out=pairs[:2])
    torch.mul(along[0], along[1], out=pairs[2])
    return pairs


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
            h, along = z[0].add_(bias), z[1:]
            a, (first, second, third) = arena.take(*z.shape), arena.take(*z.shape)
            DERIVATIVES[kind](h, (a[0], first, second, third))
            torch.mul(along, first, out=a[1:])
            up.append(a)
            bends.append((along, first, second, third))
        out = rows.new_empty(6, points, outputs)
        _times(up[-1], weights[-1].T, out[:3])
        out[0] += biases[-1]
        curved = rows.new_zeros(outputs * 3 * points)
        slope = weights[-1].detach()[:, None].expand(-1, points, -1)  # ∂u/∂a (C, n, w)
        down = []
        for (along, first, second, _), weight in zip(reversed(bends), reversed(weights[:-1]), strict=True):
            width = len(weight)
            down.append(slope)
            shape = outputs, points, width
            following = arena.take(outputs, points, weight.shape[1])
            with arena.scratch():
                through = torch.mul(slope, first, out=arena.take(*shape))
                following = _times(through, weight, following)
                bent = torch.mul(slope, second, out=through)
                product = torch.mul(bent[:, None], _pairs(along, arena), out=arena.take(outputs, 3, points, width))
                curved.addmv_(product.view(-1, width), rows.new_ones(width))
            slope = following
        out[3:] = curved.view(outputs, 3, points).permute(1, 2, 0) + torch.einsum("cnf,jnf->jnc", slope, rows[3:])
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
        curvature = g[3:].permute(2, 0, 1).unsqueeze(-1).contiguous()  # (C, 3, n, 1): xx, zz and xz
        by_along = curvature * rows.new_tensor([2, 2, 1]).view(3, 1, 1)
        # up again: what follows from the sweep down
        by_slope = (curvature * rows[3:]).sum(dim=1)
        by_weights, by_given = [], []
        for (along, first, second, third), slope, weight in zip(bends, down, weights[:-1], strict=True):
            width = len(weight)
            given, by_through = arena.take(3, points, width), arena.take(outputs, points, width)
            _times(by_slope, weight.T, by_through)
            with arena.scratch():
                form, total = arena.take(outputs, points, width), arena.take(points, width)
                by_weights.append(_flat(torch.mul(slope, first, out=form)).T @ _flat(by_slope))
                pairs, mixed = _pairs(along, arena), arena.take(3, points, width)
                bent = torch.mul(slope, second, out=form)
                _contracted(by_along, bent.unsqueeze(1), mixed)
                # the quadratic form of z_x and z_z with the matrix that the curvature's gradient is
                torch.mul(curvature[:, 0], pairs[0], out=form)
                form.addcmul_(curvature[:, 1], pairs[1]).addcmul_(curvature[:, 2], pairs[2])
                torch.mul(second, _contracted(slope, by_through, total), out=given[0])
                given[0].addcmul_(third, _contracted(slope, form, total))
                torch.mul(along, mixed[:2], out=given[1:])
                given[1].addcmul_(along[1], mixed[2])
                given[2].addcmul_(along[0], mixed[2])
                by_slope = by_through.mul_(first).addcmul_(second, form)
            by_given.append(given)
        by_weights.append(by_slope.sum(dim=1))
        # down again: what follows from the sweep up
        by_weights[-1].addmm_(_flat(g[:3]).T, _flat(up[-1]))
        by_biases = [g[0].sum(dim=0)]
        by_a = _times(g[:3], weights[-1], arena.take(*up[-1].shape))
        ones = rows.new_ones(points)
        for level in reversed(range(len(bends))):
            along, first, second, _ = bends[level]
            given = by_given[level].addcmul_(first, by_a)
            with arena.scratch():
                given[0].addcmul_(second, _contracted(by_a[1:], along, arena.take(*first.shape)))
            by_weights[level].addmm_(_flat(given).T, _flat(up[level]))
            by_biases.append(given[0].T @ ones)
            if level or ctx.needs_input_grad[0]:
                by_a = _times(given, weights[level], arena.take(*up[level].shape))
        by_rows = None
        if ctx.needs_input_grad[0]:
            by_rows = torch.cat([by_a, torch.einsum("jnc,cnf->jnf", g[3:], at_inputs)])
        return by_rows, None, *by_weights, *reversed(by_biases)
