"""Time of a residual: u, ∇u and ∇²u in closed form beside nested automatic differentiation.

    python benchmarks/derivatives.py

Forward and backward to the weights of an 8 × 100 network at 512 points, one thread, float32: the median of runs that
take turns. Values and gradients of both ways are compared in float64 first. Six rows are carried instead of one, so six
times the time of the values alone is what no closed form in these layers can beat.
"""

import shutil
import statistics
import time
from collections.abc import Callable

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor, nn

from pgdl_lab.learning.jet import ROWS, propagate
from pgdl_lab.learning.layers import fully_connected

POINTS, DEPTH, WIDTH, ROUNDS = 512, 8, 100, 40


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


def step(way: Callable[[nn.Module, Tensor], Tensor], net: nn.Module, rows: Tensor) -> list[Tensor]:
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
    return max(float((a - b).abs().max() / a.abs().max()) for a, b in pairs)


def main() -> None:
    """Print agreement and times."""
    torch.set_num_threads(1)
    table = Table(title=f"{DEPTH} × {WIDTH}, {POINTS} points, float32, one thread: forward and backward")
    for heading in ("activation", "way", "median [ms]", "least [ms]", "nested / this", "agrees to"):
        table.add_column(heading, justify="right")
    for activation in ("tanh", "silu"):
        agrees = agreement(activation)
        torch.manual_seed(0)
        net, rows = fully_connected(3, 2, DEPTH, WIDTH, activation), inputs(torch.float32)
        ways: dict[str, Callable[[], object]] = {
            "nested": lambda net=net, rows=rows: step(by_autograd, net, rows),  # type: ignore[misc]
            "closed form": lambda net=net, rows=rows: step(propagate, net, rows),  # type: ignore[misc]
            "values alone": lambda net=net, rows=rows: step(lambda n, r: n(r[0]), net, rows),  # type: ignore[misc]
        }
        if shutil.which("g++"):
            compiled = torch.compile(propagate)
            ways["closed form, compiled"] = lambda net=net, rows=rows, compiled=compiled: step(compiled, net, rows)  # type: ignore[misc]
        times: dict[str, list[float]] = {name: [] for name in ways}
        for way in ways.values():
            way()
        for _ in range(ROUNDS):
            for name, way in ways.items():
                start = time.perf_counter()
                way()
                times[name].append(1e3 * (time.perf_counter() - start))
        nested = statistics.median(times["nested"])
        for name, taken in times.items():
            median = statistics.median(taken)
            agreed = f"{agrees:.1e}" if name == "closed form" else ""
            table.add_row(activation, name, f"{median:.1f}", f"{min(taken):.1f}", f"{nested / median:.2f}", agreed)
        table.add_section()
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
