"""Time of a residual: u, ∇u and ∇²u in closed form beside nested automatic differentiation.

    python benchmarks/derivatives.py [activation ...]

Forward and backward to the weights of an 8 × 100 network at 512 points, float32: the median of the processor times of
one thread, of ways that take turns, so that other work on the machine counts little. Values and gradients of both ways
are compared in float64 first. Per hidden layer nested differentiation takes 33 matrix products of 512 × 100 by 100 ×
100 in all, six rows through the layers take 18, two sweeps 15, values alone 3: the products bound what any closed form
can gain, the more so the cheaper the activation.
"""

import shutil
import statistics
import time
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor, nn

from benchmarks.common import parsed, parser, show, table
from pgdl_lab.learning.activations import ACTIVATIONS
from pgdl_lab.learning.jet import ROWS, propagate
from pgdl_lab.learning.layers import fully_connected

POINTS, DEPTH, WIDTH = 512, 8, 100
COMPILED = ("tanh", "silu")  # compiling takes its time

Way = Callable[[nn.Module, Tensor], Tensor]


def inputs(dtype: torch.dtype) -> Tensor:
    """Rows of (x, z, p)."""
    rows = torch.zeros(ROWS[2], POINTS, 3, dtype=dtype)
    rows[0] = torch.rand(POINTS, 3, dtype=dtype)
    rows[1, :, 0] = rows[2, :, 1] = 1
    return rows


def by_autograd(net: nn.Module, rows: Tensor) -> Tensor:
    """(6, n, 2), two reverse passes for the gradients of the outputs and four for theirs."""
    points = rows[0].clone().requires_grad_()
    value = net(points)
    columns = []
    for component in value.unbind(dim=1):
        (first,) = torch.autograd.grad(component.sum(), points, create_graph=True)
        (by_x,) = torch.autograd.grad(first[:, 0].sum(), points, create_graph=True)
        (by_z,) = torch.autograd.grad(first[:, 1].sum(), points, create_graph=True)
        columns.append(torch.stack([component, first[:, 0], first[:, 1], by_x[:, 0], by_z[:, 1], by_x[:, 1]]))
    return torch.stack(columns, dim=-1)


def step(way: Way, net: nn.Module, rows: Tensor) -> list[Tensor]:
    """Gradients of the mean square of all derivatives by the weights."""
    weights = list(net.parameters())
    return list(torch.autograd.grad(way(net, rows).square().mean(), weights, allow_unused=True))


def agreement(activation: str) -> float:
    """Largest difference of values and gradients of both ways in float64, by the largest of them."""
    torch.manual_seed(0)
    net, rows = fully_connected(3, 2, DEPTH, WIDTH, activation).double(), inputs(torch.double)
    pairs = [(by_autograd(net, rows), propagate(net, rows))]
    pairs += [
        (a, b) for a, b in zip(step(by_autograd, net, rows), step(propagate, net, rows), strict=True) if a is not None
    ]
    return max(float(((a - b).abs().max() / a.abs().max()).detach()) for a, b in pairs)


def values(net: nn.Module, rows: Tensor) -> Tensor:
    """The values without derivatives."""
    return net(rows[0])


def main() -> None:
    """Print agreement and times."""
    arguments = parser(__doc__)
    arguments.add_argument("activations", nargs="*", default=[name for name in ACTIVATIONS if name != "relu"])
    arguments.add_argument("--rounds", type=int, default=40)
    given = parsed(arguments, activations=["gelu"], rounds=3)
    torch.set_num_threads(1)
    title = f"{DEPTH} × {WIDTH}, {POINTS} points, float32, one thread: forward and backward"
    headings = ("activation", "way", "median [ms]", "least [ms]", "nested / this", "agrees to")
    shown = table(title, headings, left=0)
    for activation in given.activations:
        agrees = agreement(activation)
        torch.manual_seed(0)
        net, rows = fully_connected(3, 2, DEPTH, WIDTH, activation), inputs(torch.float32)
        ways: dict[str, Way] = {"nested": by_autograd, "closed form": propagate, "values alone": values}
        if activation in COMPILED and shutil.which("g++"):
            ways["closed form, compiled"] = torch.compile(propagate)
        steps = {name: partial(step, way, net, rows) for name, way in ways.items()}
        times: dict[str, list[float]] = {name: [] for name in ways}
        for once in steps.values():
            once()
        for _ in range(given.rounds):
            for name, once in steps.items():
                start = time.thread_time()
                once()
                times[name].append(1e3 * (time.thread_time() - start))
        nested = statistics.median(times["nested"])
        for name, taken in times.items():
            median = statistics.median(taken)
            agreed = f"{agrees:.1e}" if name == "closed form" else ""
            shown.add_row(activation, name, f"{median:.1f}", f"{min(taken):.1f}", f"{nested / median:.2f}", agreed)
        shown.add_section()
    show(shown)


if __name__ == "__main__":
    main()
