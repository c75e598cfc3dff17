"""The same training in DeepXDE and PINA: time of a step and error after the same wall time, beside the lab's own.

    pip install -c constraints.txt -e '.[bench]'
    python benchmarks/learning_peers.py [--finger pneunet] [--seconds 30]

All train 8 × 100 tanh neurons on (x, z, p), scaled to −1 … 1, with Adam, 512 of the same training points per step, on
the data and on the corrected Navier–Cauchy residual with the same weight, in float32 on one thread. The residual is
taken at the same 512 points; DeepXDE's own data set for such problems, `PDE` with `PointSetBC`, wants points of its own
for it, and evaluates the residual at both: it has a line of its own, with 512 fixed training points. Times of a step
are processor times, so that other work on the machine counts little; compiling, half a minute of the same wall time, is
not part of a step. The last line is the default model, with the time
that it takes. A package that is not installed is left out.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import cached_property, partial
from importlib.util import find_spec
from typing import Any

import lightning.pytorch as pl
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.common import missing, parsed, parser
from benchmarks.scenes import fitted, scene, simulated
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
from pgdl_lab.running.experiment import Experiment

Floats = NDArray[np.float64]
DEPTH, WIDTH, BATCH, RATE = 8, 100, 512, 1e-3


@dataclass(frozen=True)
class Task:
    """What all of them learn, in `seconds`."""

    made: Experiment
    snapshots: Dataset
    train: NDArray[np.int64]
    weight: float
    seconds: float

    @cached_property
    def scene(self) -> Scene:
        """The body that they belong to."""
        return Scene.of(self.made.finger, self.snapshots)

    @cached_property
    def samples(self) -> Samples:
        """The training points."""
        return Samples.of(self.snapshots, self.train)

    @cached_property
    def inputs(self) -> Tensor:
        """(n, 3) x, z [mm], p [kPa]."""
        samples = self.samples
        return torch.from_numpy(np.column_stack([samples.points_mm, samples.pressures_kpa])).float()

    @cached_property
    def targets(self) -> Tensor:
        """(n, 2) [mm]."""
        return torch.from_numpy(self.samples.displacements_mm).float()

    def scaled(self, inputs: Tensor) -> Tensor:
        """Inputs between −1 and 1."""
        low, high = self.inputs.min(dim=0).values, self.inputs.max(dim=0).values
        return (2 * inputs - low - high) / (high - low)

    def unscaled(self, outputs: Tensor) -> Tensor:
        """Displacements [mm] from outputs between −1 and 1."""
        low, high = self.targets.min(dim=0).values, self.targets.max(dim=0).values
        return (outputs * (high - low) + low + high) / 2

    def residuals(self, second: Callable[[int, int, int], Tensor]) -> list[Tensor]:
        """Of the Navier–Cauchy equation, from second(component, i, j), the second derivative by x_i and x_j."""
        lame, shear = self.scene.lame_mpa, self.scene.shear_modulus_mpa
        return [
            (lame + shear) * (second(0, 0, i) + second(1, 1, i))
            + shear * (second(i, 0, 0) + second(i, 1, 1)) + self.scene.body_force_n_mm3[i]
            for i in range(2)
        ]  # fmt: skip

    def mse(self, predict: Callable[[Tensor], Tensor]) -> tuple[float, float]:
        """Mean squared errors of u_x and u_z over the unseen points [mm²]."""
        points = torch.from_numpy(self.snapshots.domain.points_mm).float()
        with torch.no_grad():
            fields = [
                predict(torch.cat([points, torch.full((len(points), 1), float(kpa))], dim=1)).detach().numpy()
                for kpa in self.snapshots.pressures_kpa
            ]
        error = np.delete((np.stack(fields) - self.snapshots.displacements).reshape(-1, 2), self.train, axis=0)
        x, z = (error**2).mean(axis=0)
        return float(x), float(z)


Outcome = tuple[float, float, float]  # processor seconds per step, MSE of u_x and of u_z


class Steps(pl.Callback):
    """Counts steps and the processor time that they take together, without the first epoch, in which all is set up."""

    def __init__(self) -> None:
        self.count, self.seconds, self._start = 0, 0.0, 0.0

    def on_train_epoch_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        if trainer.current_epoch == 1:
            self.count, self._start = 0, time.thread_time()

    def on_train_batch_end(self, *args: Any) -> None:
        self.count += 1
        self.seconds = time.thread_time() - self._start

    @property
    def seconds_each(self) -> float:
        """Of one step [s]; not a number if the time was over before the second epoch."""
        return self.seconds / self.count if self.count else float("nan")


def ours(task: Task, compiled: bool = False) -> Outcome:
    """The lab's network with the same settings."""
    steps = Steps()
    same = replace(
        task.made,
        model=plugin("model", "mlp")(depth=DEPTH, width=WIDTH, activation="tanh"),
        loss={**task.made.loss, "navier_cauchy": plugin("loss", "navier_cauchy")(weight=task.weight)},
        trainer=TrainerSettings(str(task.seconds), 10**6, "cpu", validation=0.0, compile=compiled, progress=False),
        optimizer=OptimizerSettings(lr=RATE, batch_size=BATCH, schedule="constant"),
    )
    surrogate, _ = fitted(same, task.snapshots, task.train, callbacks=[steps])
    return steps.seconds_each, *_mse_of(task, surrogate)


def default(task: Task) -> Outcome:
    """The default model; its "step" is its whole training."""
    surrogate, seconds = fitted(task.made, task.snapshots, task.train)
    return seconds, *_mse_of(task, surrogate)


def _mse_of(task: Task, surrogate: Any) -> tuple[float, float]:
    error = (
        surrogate.predict(task.snapshots.domain.points_mm, task.snapshots.pressures_kpa) - task.snapshots.displacements
    )
    x, z = (np.delete(error.reshape(-1, 2), task.train, axis=0) ** 2).mean(axis=0)
    return float(x), float(z)


def deepxde(task: Task) -> Outcome:
    """DeepXDE on PyTorch, with a data set of its own kind, so that residuals are taken at the 512 points alone."""
    os.environ["DDE_BACKEND"] = "pytorch"
    import deepxde as dde

    rng = np.random.default_rng(0)
    inputs, targets = task.inputs.numpy(), task.targets.numpy()

    class Points(dde.data.Data):
        def losses(self, targets: Any, outputs: Any, loss_fn: Any, inputs: Any, model: Any, aux: Any = None) -> Any:
            residuals = task.residuals(lambda c, i, j: dde.grad.hessian(outputs, inputs, component=c, i=i, j=j))
            data = sum((outputs[:, i] - targets[:, i]).square().mean() for i in range(2))
            return [data, task.weight * sum(residual.square().mean() for residual in residuals)]

        def train_next_batch(self, batch_size: int | None = None) -> Any:
            chosen = rng.integers(len(inputs), size=BATCH)
            return inputs[chosen], targets[chosen]

        def test(self) -> Any:
            return inputs[:2], targets[:2]

    return _trained_by_deepxde(task, Points(), None, [])


def deepxde_standard(task: Task) -> Outcome:
    """DeepXDE on PyTorch with its own `PDE` and `PointSetBC`, as in its examples."""
    os.environ["DDE_BACKEND"] = "pytorch"
    import deepxde as dde

    inputs = task.inputs.numpy()

    def pde(inputs: Any, outputs: Any) -> list[Tensor]:
        return task.residuals(lambda c, i, j: dde.grad.hessian(outputs, inputs, component=c, i=i, j=j))

    known = dde.icbc.PointSetBC(inputs, task.targets.numpy(), component=[0, 1], batch_size=BATCH)
    fixed = inputs[np.random.default_rng(0).integers(len(inputs), size=BATCH)]
    box = dde.geometry.Hypercube(inputs.min(axis=0), inputs.max(axis=0))
    data = dde.data.PDE(box, pde, [known], anchors=fixed)
    # its mean is over both components, ours a sum of two means
    weights = [task.weight, task.weight, 2.0]
    return _trained_by_deepxde(task, data, weights, [dde.callbacks.PDEPointResampler(period=1, pde_points=False)])


def _trained_by_deepxde(task: Task, data: Any, weights: list[float] | None, callbacks: list[Any]) -> Outcome:
    import deepxde as dde

    network = dde.nn.FNN([3, *[WIDTH] * DEPTH, 2], "tanh", "Glorot uniform")
    network.apply_feature_transform(task.scaled)
    network.apply_output_transform(lambda _, outputs: task.unscaled(outputs))
    model = dde.Model(data, network)
    model.compile("adam", lr=RATE, loss_weights=weights, verbose=0)
    model.train(iterations=3, display_every=10**9, verbose=0)  # the first steps set up more than they learn
    first, start, began = model.train_state.step, time.perf_counter(), time.thread_time()

    class Stop(dde.callbacks.Callback):
        def on_epoch_end(self) -> None:
            self.model.stop_training = time.perf_counter() - start >= task.seconds

    model.train(iterations=10**6, display_every=10**9, verbose=0, callbacks=[*callbacks, Stop()])
    seconds, steps = time.thread_time() - began, model.train_state.step - first
    return seconds / steps, *task.mse(network)


def pina(task: Task) -> Outcome:
    """PINA with two conditions on the same points."""
    import logging

    from lightning.pytorch.callbacks import Timer
    from pina import Condition, LabelTensor, Trainer
    from pina.equation import Equation
    from pina.operator import grad
    from pina.optim import TorchOptimizer
    from pina.problem import BaseProblem
    from pina.solver import PhysicsInformedSingleModelSolver
    from pina.weighting import ScalarWeighting

    names, axes = ["ux", "uz"], ["x", "z"]

    def residual(inputs: Any, outputs: Any) -> Any:
        first = grad(outputs, inputs, components=names, d=axes)

        def second(component: int, i: int, j: int) -> Any:
            along = f"d{names[component]}d{axes[i]}"
            return grad(first, inputs, components=[along], d=[axes[j]]).as_subclass(torch.Tensor)[:, 0]

        return torch.stack(task.residuals(second), dim=1)

    class Network(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            sizes = [3, *[WIDTH] * DEPTH]
            layers = [part for a, b in zip(sizes[:-1], sizes[1:], strict=True)
                      for part in (torch.nn.Linear(a, b), torch.nn.Tanh())]  # fmt: skip
            self.layers = torch.nn.Sequential(*layers, torch.nn.Linear(WIDTH, 2))

        def forward(self, inputs: Any) -> Any:
            return task.unscaled(self.layers(task.scaled(inputs.as_subclass(torch.Tensor))))

    points = LabelTensor(task.inputs.clone(), ["x", "z", "p"])
    values = LabelTensor(task.targets.clone(), names)

    class Finger(BaseProblem):
        input_variables = ["x", "z", "p"]
        output_variables = names
        conditions = {
            "data": Condition(input=points, target=values),
            "physics": Condition(input=points, equation=Equation(residual)),
        }

    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    network = Network()
    # its mean is over both components, ours a sum of two means: factors 2 make the objectives equal
    weighting = ScalarWeighting({"data": 2.0, "physics": 2 * task.weight})
    solver = PhysicsInformedSingleModelSolver(
        Finger(), network, optimizer=TorchOptimizer(torch.optim.Adam, lr=RATE), weighting=weighting
    )
    steps = Steps()
    trainer = Trainer(
        solver, batch_size=BATCH, max_epochs=10**6, accelerator="cpu", enable_progress_bar=False, logger=False,
        enable_checkpointing=False, enable_model_summary=False,
        callbacks=[Timer(timedelta(seconds=task.seconds)), steps],
    )  # fmt: skip
    trainer.train()
    return steps.seconds_each, *task.mse(network)


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--finger", default="pneunet")
    arguments.add_argument("--seconds", type=float, default=30)
    arguments.add_argument("--weight", type=float, default=1e-4, help="of the residual")
    given = parsed(arguments, seconds=3.0)
    torch.set_num_threads(1)
    made = scene(given.finger, "trainer.accelerator=cpu", quick=given.quick)
    snapshots = simulated(made)
    task = Task(made, snapshots, made.split.train_points(snapshots, 0), given.weight, given.seconds)
    torch.manual_seed(0)
    print(f"{given.finger}, random split, {given.seconds:g} s each, residual's weight {given.weight:g}")
    print(f"{'':<24}{'step [ms]':>10}{'× ours':>8}{'MSE x [mm²]':>13}{'MSE z [mm²]':>13}")
    methods: dict[str, tuple[Callable[[Task], Outcome], str | None]] = {
        "pgdl_lab, same network": (ours, None),
        "pgdl_lab, compiled": (partial(ours, compiled=True), None),
        "DeepXDE, 512 points": (deepxde, "deepxde"),
        "DeepXDE, 512 + 512": (deepxde_standard, "deepxde"),
        "PINA": (pina, "pina"),
    }
    least = float("nan")
    for name, (method, package) in methods.items():
        if package is not None and find_spec(package) is None:
            missing(name, package)
            continue
        seconds, x, z = method(task)
        least = seconds if method is ours else least
        print(f"{name:<24}{1e3 * seconds:>10.1f}{seconds / least:>8.1f}{x:>13.2e}{z:>13.2e}", flush=True)
    seconds, x, z = default(task)
    print(f"{f'default, {seconds:.0f} s in all':<24}{'–':>10}{'–':>8}{x:>13.2e}{z:>13.2e}")


if __name__ == "__main__":
    main()
