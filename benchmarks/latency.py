"""How long a prediction takes: every model in every form, beside the finite elements and the paper's network.

    python benchmarks/latency.py [--seconds 0.3] [--loop 60] [--model hybrid]

The default finger, its full field of 4,439 points and its tip, at one pressure that changes with every call; median and
99th percentile on one thread and, if this process may use as many processors, on two, beside the size of the file and
the largest difference from the original over 10,000 random queries. Forms: `original` and `numpy` prepared for the
points (`surrogate.at`), as a control loop does; `torch.export` and `onnx` look the points up in every call. Networks
are trained for one epoch, as their weights do not matter here. At the end a loop of 1 kHz: every millisecond a place
for the tip becomes a pressure, and the pressure the tip and the full field.
"""

import gc
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import parsed, parser, print_load
from benchmarks.scenes import fitted, scene, simulated
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.export.export import Form, Predict, export, read_onnx
from pgdl_lab.learning.threads import threads
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.surrogate.surrogate import Surrogate

MODELS = {
    "hybrid": ["model=hybrid"],
    "pod": ["model=pod"],
    "finite_element": ["model=finite_element"],
    "body": ["model=body"],
    "mlp": ["model=mlp"],
    "the paper's 8×100": ["experiment=paper_random"],
}
THREADS = [count for count in (1, 2) if count <= len(os.sched_getaffinity(0))]
WITHIN, BEYOND = (0.0, 1.0), (1.0, 1.2)  # of the highest trained pressure
HELD_UP = 0.9e-3  # s: with what a computation takes, a period is over
Call = Callable[[float], object]
Floats = NDArray[np.float64]


def main() -> None:
    """Print the tables."""
    arguments = parser(__doc__)
    arguments.add_argument("--seconds", type=float, default=0.3, help="for each measurement")
    arguments.add_argument("--model", nargs="*", default=list(MODELS), choices=list(MODELS))
    arguments.add_argument("--loop", type=float, default=60.0, help="seconds of the loop of 1 kHz")
    given = parsed(arguments, seconds=0.01, model=["hybrid", "pod"], loop=1.0)
    snapshots = simulated(scene("pneunet", quick=given.quick))
    print("median / 99th percentile [µs]\n")
    timed = [f"{what}, {count} thread{'s' * (count > 1)}" for count in THREADS for what in ("tip", "field")]
    line("model", "form", "kB", "difference [mm]", *timed)
    line(*["---"] * (4 + len(timed)))
    with tempfile.TemporaryDirectory() as folder:
        for name in given.model:
            surrogate = trained(scene("pneunet", *MODELS[name], quick=given.quick), snapshots, Path(folder) / name)
            for form, size, difference, calls in forms(surrogate, snapshots, Path(folder) / name):
                row = [measured(call, snapshots, given.seconds, count) for count, call in calls]
                line(name, form, f"{size / 1e3:.0f}", difference, *row)
                if form == "original":
                    row = [measured(call, snapshots, given.seconds, count, BEYOND) for count, call in calls]
                    line(name, "original, beyond the trained pressures", "", "", *row)
            if name == "hybrid":
                default_surrogate = surrogate
    seconds = snapshots.provenance["seconds"]
    solved = 1 if snapshots.body is None else len(snapshots.body.pressures_kpa)
    for what, each in (("100 snapshots", seconds), ("one equilibrium", seconds / solved)):
        line("finite elements", what, "", "", *[f"{1e6 * each:.3g}"] * 2, *[""] * (len(timed) - 2))
    if "hybrid" in given.model and given.loop:
        loop(default_surrogate, given.loop)
    print_load()


def line(*cells: str) -> None:
    """Print a line of a table in Markdown."""
    print(f"| {' | '.join(cells)} |", flush=True)


def trained(made: Experiment, snapshots: Dataset, folder: Path) -> Surrogate:
    """A surrogate of the default finger, networks after one epoch."""
    folder.mkdir()
    once = replace(made, loss={"data": made.loss["data"]}, trainer=replace(made.trainer, max_epochs=1))
    surrogate, _ = fitted(once, snapshots, made.split.train_points(snapshots, 0))
    surrogate.save(folder / "surrogate.pt")
    return surrogate


def forms(
    surrogate: Surrogate, snapshots: Dataset, folder: Path
) -> Iterator[tuple[str, int, str, list[tuple[int, Call]]]]:
    """Name, bytes and difference [mm] of each form, and the timed calls: number of threads and tip or field."""
    points, tip = snapshots.domain.points_mm, snapshots.domain.points_mm[snapshots.domain.base[-1:]]

    def prepared(which: Surrogate) -> list[tuple[int, Call]]:
        return [(count, which.at(where)) for count in THREADS for where in (tip, points)]

    def unprepared(predict: Callable[[int], Predict]) -> list[tuple[int, Call]]:
        def asked(made: Predict, where: Floats, kpa: float) -> Any:
            return made(where, np.array([kpa]))

        made = [(count, predict(count)) for count in THREADS]
        return [(count, partial(asked, each, where)) for count, each in made for where in (tip, points)]

    yield "original", (folder / "surrogate.pt").stat().st_size, "", prepared(surrogate)
    for form in export(surrogate, folder / "export"):
        if not isinstance(form, Form):
            continue
        size, difference = form.path.stat().st_size, f"{form.difference_mm:.1g}"
        if form.name == "numpy":
            from pgdl_lab import load

            yield form.name, size, difference, prepared(load(form.path, outside="ignore"))
        elif form.name == "onnx":
            yield form.name, size, difference, unprepared(partial(read_onnx, form.path))
        else:
            yield form.name, size, difference, unprepared(partial(_whatever_threads, form.predict))


def _whatever_threads(predict: Predict, _: int) -> Predict:
    return predict


def measured(call: Call, snapshots: Dataset, seconds: float, count: int, share: tuple[float, float] = WITHIN) -> str:
    """Median and 99th percentile of `call` on `count` threads, at shares of the highest pressure [µs]."""
    pressures = (snapshots.pressures_kpa[-1] * np.random.default_rng(0).uniform(*share, 997)).tolist()
    with threads(count):
        for kpa in pressures[:3]:
            call(kpa)
        times: list[float] = []
        end = time.perf_counter() + seconds
        while len(times) < 100 or time.perf_counter() < end:
            kpa = pressures[len(times) % len(pressures)]
            start = time.perf_counter()
            call(kpa)
            times.append(time.perf_counter() - start)
    median, high = 1e6 * np.percentile(times, [50, 99])
    return f"{median:.3g} / {high:.3g}"


def loop(surrogate: Surrogate, seconds: float) -> None:
    """Follow a moving tip at 1 kHz and tell how long the model took in each period, and how often the machine stood.

    Between two computations the loop only reads the clock: what holds it up there is not the model.
    """
    tip, top = surrogate.tip_mm, surrogate.ranges["pressure_kpa"][1]
    at, field = surrogate.at([tip]), surrogate.at(surrogate.domain.points_mm)
    targets = [tip + at(top * (0.5 - 0.45 * np.cos(2 * np.pi * k / 2000)))[0] for k in range(2000)]  # 2 s up and down
    surrogate.pressure_for(tip=targets[0])
    wall, own, held_up = [], [], []
    gc.collect()
    gc.disable()
    begin = now = time.perf_counter()
    for tick in range(int(1000 * seconds)):
        while now < begin + tick * 1e-3:
            before, now = now, time.perf_counter()
            if now - before > HELD_UP:
                held_up.append(now - before)
        start, start_own = time.perf_counter(), time.thread_time()
        kpa = float(surrogate.pressure_for(tip=targets[tick % len(targets)]))
        at(kpa)
        field(kpa)
        now = time.perf_counter()
        wall.append(now - start)
        own.append(time.thread_time() - start_own)
    gc.enable()
    for name, times in (("on the clock", wall), ("of its own processor time", own)):
        middle, high, most = 1e6 * np.percentile(times, [50, 99, 100])
        late = int((np.array(times) > 1e-3).sum())
        print(f"1 kHz for {seconds:g} s, pressure for the tip, tip and full field, {name}: median {middle:.0f}, "
              f"p99 {high:.0f}, most {most:.0f} µs; {late} of {len(times)} over 1 ms")  # fmt: skip
    print(f"in the {seconds - sum(wall):.0f} s between, reading the clock alone: held up {len(held_up)} times for over "
          f"{1e3 * HELD_UP:g} ms, at most {1e6 * max(held_up, default=0.0):.0f} µs")  # fmt: skip


if __name__ == "__main__":
    main()
