"""The paper's training to its end: 8×100 ReLU, Adam, batches of 512, 100,000 epochs, in float32.

    python benchmarks/paper_protocol.py [--split extrapolate] [--epochs 100000] [--draw]

It is `experiment=paper_random` (or `paper_extrapolate`). The residual of eq. (7) is part of its loss, but second
derivatives of a ReLU network are zero, so that term is a constant and its gradient is exactly zero: what trains is the
data alone. That is checked at the start, where twenty steps of the loop below, which knows the data term only, are held
against the same steps by PyTorch's autograd with both terms.

The loop writes the gradient out into memory that is reused: nine tenths of a step are matrix products. An epoch of 40
steps takes 0.12 s on one core, the whole training 3.2 hours. It can be stopped at any time and goes on from its last
minute. Errors over the points not trained on are appended to docs/data/paper_protocol_<split>.csv; `--draw` makes the
figure from these files.
"""

import csv
import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.common import folders, panels, parsed, parser, save
from benchmarks.scenes import scene, simulated
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.files import replacing
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.field import PlaneField
from pgdl_lab.learning.jet import Affine
from pgdl_lab.learning.layers import fully_connected
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.threads import threads

NAME = "paper_protocol"
SPLITS = ("random", "extrapolate")
DEPTH, WIDTH, BATCH, RATE = 8, 100, 512, 1e-3
SAVE_EVERY_S = 60.0
JUDGED_PER_DECADE = 40  # epochs after which the errors are taken, evenly spaced on a logarithmic scale

Floats = NDArray[np.float32]


class Network:
    """Eight hidden layers of ReLU from (x, z, p) to (u_x, u_z), all scaled to [0, 1], and Adam's state.

    Parameters
    ----------
    layers
        The initial weights.
    weight
        What a squared error of each scaled output counts (2,): the square of its range [mm²].
    """

    def __init__(self, layers: torch.nn.Sequential, weight: Tensor) -> None:
        linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
        count = sum(layer.weight.numel() + layer.bias.numel() for layer in linear)
        self.parameters, self.gradient, self.mean, self.square = torch.zeros(4, count).unbind()
        self.weights, self.biases = self._views(self.parameters, linear)
        self._weight_gradients, self._bias_gradients = self._views(self.gradient, linear)
        for layer, matrix, bias in zip(linear, self.weights, self.biases, strict=True):
            matrix.copy_(layer.weight.detach().T)
            bias.copy_(layer.bias.detach())
        self.steps = torch.zeros(())
        self._factor = 2 * weight.float()
        self._memory: dict[int, tuple[list[Tensor], list[Tensor]]] = {}

    @staticmethod
    def _views(flat: Tensor, linear: list[torch.nn.Linear]) -> tuple[list[Tensor], list[Tensor]]:
        matrices, biases, start = [], [], 0
        for layer in linear:
            rows, columns = layer.in_features, layer.out_features
            matrices.append(flat[start : start + rows * columns].view(rows, columns))
            start += rows * columns
            biases.append(flat[start : start + columns])
            start += columns
        return matrices, biases

    def _layers(self, rows: int) -> tuple[list[Tensor], list[Tensor]]:
        """Outputs of the layers and the loss's derivatives by them, for a batch of `rows`; made once."""
        if rows not in self._memory:
            first, second = (
                [torch.empty(rows, matrix.shape[0]) for matrix in [*self.weights, self.weights[-1].T]] for _ in range(2)
            )
            self._memory[rows] = first, second
        return self._memory[rows]

    def predict(self, inputs: Tensor) -> Tensor:
        """Scaled displacements (n, 2) for scaled inputs (n, 3); overwritten by the next call."""
        outputs, _ = self._layers(len(inputs))
        last, hidden = len(self.weights) - 1, inputs
        for number, (matrix, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            torch.addmm(bias, hidden, matrix, out=outputs[number + 1])
            hidden = outputs[number + 1] if number == last else outputs[number + 1].relu_()
        return hidden

    def step(self, inputs: Tensor, targets: Tensor) -> Tensor:
        """One step of Adam on a batch; gives the sum of the weighted squared errors before it."""
        outputs, slopes = self._layers(len(inputs))
        slope = torch.sub(self.predict(inputs), targets, out=slopes[-1])
        loss = (slope.square().sum(dim=0) * self._factor).sum() / 2
        slope *= self._factor / len(inputs)
        for number in reversed(range(len(self.weights))):
            below = outputs[number] if number else inputs
            torch.mm(below.T, slope, out=self._weight_gradients[number])
            torch.sum(slope, 0, out=self._bias_gradients[number])
            if number:
                torch.mm(slope, self.weights[number].T, out=slopes[number])
                slope = slopes[number]
                torch.ops.aten.threshold_backward.grad_input(slope, below, 0, grad_input=slope)
        self.steps += 1
        torch._fused_adam_(
            [self.parameters], [self.gradient], [self.mean], [self.square], [], [self.steps],
            lr=RATE, beta1=0.9, beta2=0.999, weight_decay=0.0, eps=1e-8, amsgrad=False, maximize=False,
        )  # fmt: skip
        return loss


class Protocol:
    """One of the paper's two trainings, with its errors on the points that it does not see."""

    def __init__(self, split: str, store: Path, data: Path, quick: bool) -> None:
        made = scene("pneunet", f"split={split}", quick=quick)
        self.split = made.split
        self.folder, self.csv = store / split, data / f"{NAME}_{split}.csv"
        self.csv.parent.mkdir(parents=True, exist_ok=True)
        self.folder.mkdir(parents=True, exist_ok=True)
        kept = self.folder / "snapshots.h5"  # so that a training goes on with the data that it began with
        if not kept.exists():
            simulated(made).save(kept)
        self.snapshots = Dataset.load(kept)
        train = made.split.train_points(self.snapshots, 0)
        self.samples, self.scene = Samples.of(self.snapshots, train), Scene.of(made.finger, self.snapshots)
        self.unseen = np.setdiff1d(np.arange(self.snapshots.displacements.size // 2), train)

        inputs = np.column_stack([self.samples.points_mm, self.samples.pressures_kpa])
        self.low, self.span = inputs.min(axis=0), np.ptp(inputs, axis=0)
        self.low_mm, self.span_mm = (of(self.samples.displacements_mm, axis=0) for of in (np.min, np.ptp))
        self.inputs = torch.from_numpy((inputs - self.low) / self.span).float()
        self.targets = torch.from_numpy((self.samples.displacements_mm - self.low_mm) / self.span_mm).float()
        torch.manual_seed(0)
        self.layers = fully_connected(3, 2, DEPTH, WIDTH, "relu")
        self.network = Network(self.layers, torch.from_numpy(self.span_mm**2))
        self.epoch, self.seconds = 0, 0.0

    def batches(self, epoch: int) -> tuple[list[Tensor], list[Tensor]]:
        """The training points in the order of an epoch."""
        order = torch.randperm(len(self.inputs), generator=torch.Generator().manual_seed(epoch))
        return list(torch.split(self.inputs[order], BATCH)), list(torch.split(self.targets[order], BATCH))

    def check(self) -> None:
        """Hold the loop against autograd with data and eq. (7), from the same weights on the same batches."""
        field = PlaneField(
            torch.nn.Sequential(
                Affine(torch.from_numpy(1 / self.span), torch.from_numpy(-self.low / self.span)),
                *self.layers,
                Affine(torch.from_numpy(self.span_mm), torch.from_numpy(self.low_mm)),
            ),
            torch.float32,
        )
        data, physics = plugin("loss", "data")(), plugin("loss", "navier_cauchy")(form="corrected", weight=1.0)
        adam = torch.optim.Adam(field.parameters(), lr=RATE)
        ours = Network(self.layers, torch.from_numpy(self.span_mm**2))
        span, low = torch.from_numpy(self.span).float(), torch.from_numpy(self.low).float()
        for inputs, targets in list(zip(*self.batches(0), strict=True))[:20]:
            here = inputs * span + low
            jet = field.jet(field.coordinates(here[:, :2].double().numpy(), 2), here[:, 2], 2)
            wanted = targets * torch.from_numpy(self.span_mm).float() + torch.from_numpy(self.low_mm).float()
            adam.zero_grad()
            (data.value(jet, wanted, self.scene) + physics.value(jet, wanted, self.scene)).backward()
            adam.step()
            with torch.no_grad():
                ours.step(inputs, targets)
        linear = [layer for layer in field.layers if isinstance(layer, torch.nn.Linear)]
        for layer, matrix in zip(linear, ours.weights, strict=True):
            # a change of the weights after 20 steps is some 0.02
            if not torch.allclose(layer.weight.T, matrix, atol=2e-4):
                raise SystemExit("The loop and autograd part: do not trust the loop.")

    def errors(self) -> list[float]:
        """Mean squared errors over the unseen points: of x and z in all, then of x and z at the highlighted pressures.

        Highlights are those of the split: 10, 20 … 50 kPa, or 45, 47 and 50 kPa.
        """
        nodes, pressures = len(self.snapshots.domain.points_mm), self.snapshots.pressures_kpa
        squared = np.empty_like(self.snapshots.displacements)
        for number, kpa in enumerate(pressures):
            inputs = (np.column_stack([self.snapshots.domain.points_mm, np.full(nodes, kpa)]) - self.low) / self.span
            scaled = self.network.predict(torch.from_numpy(inputs).float()).double().numpy()
            predicted = scaled * self.span_mm + self.low_mm
            squared[number] = (predicted - self.snapshots.displacements[number]) ** 2
        unseen = np.zeros(squared.shape[:2], dtype=bool)
        unseen.flat[self.unseen] = True
        found = [squared[unseen].mean(axis=0)]
        found += [squared[i][unseen[i]].mean(axis=0) for i in self.highlights]
        return [float(value) for pair in found for value in pair]

    @property
    def highlights(self) -> NDArray[np.int64]:
        """The pressures that the paper reports."""
        return self.split.highlights(self.snapshots.cases)

    def train(self, epochs: int) -> None:
        """Go on to `epochs`."""
        state = self.folder / "state.pt"
        if state.exists():
            self._restore(state)
        else:
            shown = [f"{axis}_{self.snapshots.pressures_kpa[i]:g}kpa" for i in self.highlights for axis in "xz"]
            columns = ["epoch", "seconds", "train_mm2", "unseen_x_mm2", "unseen_z_mm2", *shown]
            self.csv.write_text(",".join(columns) + "\n", encoding="utf-8")
        judged = set(np.unique(np.geomspace(1, epochs, int(np.log10(epochs) * JUDGED_PER_DECADE)).astype(int)))
        saved = begun = time.monotonic()
        while self.epoch < epochs:
            loss = torch.stack([self.network.step(*batch) for batch in zip(*self.batches(self.epoch), strict=True)])
            self.epoch += 1
            now = time.monotonic()
            if self.epoch in judged or self.epoch == epochs:
                self.seconds, begun = self.seconds + now - begun, now
                row = [self.epoch, round(self.seconds), float(loss.sum()) / len(self.inputs), *self.errors()]
                with self.csv.open("a", encoding="utf-8") as file:
                    file.write(",".join(f"{value:.6g}" for value in row) + "\n")
                print(f"{self.csv.stem}: epoch {row[0]}, {row[1]} s, trained {row[2]:.3g}, unseen x {row[3]:.3g}, "
                      f"z {row[4]:.3g} mm²", flush=True)  # fmt: skip
                begun = time.monotonic()
            if now - saved > SAVE_EVERY_S or self.epoch == epochs:
                self.seconds, begun, saved = self.seconds + now - begun, now, now
                network = self.network
                parts = (network.parameters, network.mean, network.square, network.steps)
                with replacing(state) as temporary:
                    torch.save({"epoch": self.epoch, "seconds": self.seconds, "parts": parts}, temporary)

    def _restore(self, state: Path) -> None:
        kept = torch.load(state, weights_only=True)
        self.epoch, self.seconds = kept["epoch"], kept["seconds"]
        network = self.network
        for part, values in zip(
            (network.parameters, network.mean, network.square, network.steps), kept["parts"], strict=True
        ):
            part.copy_(values)
        # what was judged after the state was kept will be judged again
        lines = self.csv.read_text(encoding="utf-8").splitlines(keepends=True)
        self.csv.write_text(
            "".join([lines[0], *(line for line in lines[1:] if int(line.split(",")[0]) <= self.epoch)]),
            encoding="utf-8",
        )


def draw(data: Path, path: Path) -> None:
    """Errors against epochs, of the trainings that there are."""
    found = [split for split in SPLITS if (data / f"{NAME}_{split}.csv").exists()]
    figure, axes = panels(1, len(found), (1 + 4 * len(found), 3.6), sharey=True, squeeze=False)
    for axis, split in zip(axes[0], found, strict=True):
        with (data / f"{NAME}_{split}.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        epochs = [float(row["epoch"]) for row in rows]
        last = [name.partition("_")[2] for name in rows[0] if name.startswith("x_")][-1]
        where = {"unseen points": "unseen_{}_mm2"} if split == "random" else {f"at {last[:-3]} kPa": f"{{}}_{last}"}
        for name, column in where.items():
            for component, colour in (("x", "C0"), ("z", "C1")):
                values = [float(row[column.format(component)]) for row in rows]
                axis.loglog(epochs, values, color=colour, label=f"u_{component}, {name}")
        axis.loglog(epochs, [float(row["train_mm2"]) for row in rows], color="0.6", lw=1, label="training loss")
        axis.set(title=f"split={split}", xlabel="epochs")
        axis.grid(which="major", alpha=0.3)
        axis.legend(frameon=False)
    axes[0, 0].set_ylabel("mean squared error (mm²)")
    save(figure, path, dpi=150)


def main() -> None:
    """Train, or draw what the trainings left."""
    arguments = parser(__doc__)
    arguments.add_argument("--split", default="random", choices=SPLITS)
    arguments.add_argument("--epochs", type=int, default=100_000)
    arguments.add_argument("--draw", action="store_true", help="make the figure, train nothing")
    given = parsed(arguments, epochs=5)
    store, docs = folders(NAME, given.quick)
    if not given.draw:
        protocol = Protocol(given.split, store, docs / "data", given.quick)
        protocol.check()
        with threads(1), torch.no_grad():
            protocol.train(given.epochs)
    if given.draw or given.quick:
        draw(docs / "data", docs / "figures" / f"{NAME}.png")


if __name__ == "__main__":
    main()
