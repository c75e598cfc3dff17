"""Follow a path with the tip: the surrogate in the controller, the finite elements as the finger.

    python examples/follow_path.py [RUN]

RUN is the folder of a training (runs/latest). The finger that is steered is not the one that the surrogate knows: its
rubber is 5 % softer, and its air comes late, through a tube (30 ms) and a valve (time constant 60 ms). Twice the tip is
asked to follow the same path at 100 Hz: once by `pressure_for` alone, looking as far ahead as the air is late; once
with the difference between the tip that is seen and the tip that the surrogate expects taken off the target (an
internal model: M. Morari & E. Zafiriou, Robust Process Control, 1989). Draws docs/figures/control.png.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from pgdl_lab.core import paths
from pgdl_lab.running import cache, composing
from pgdl_lab.running.experiment import Experiment, restore
from pgdl_lab.running.folders import stored_run, stored_surrogate
from pgdl_lab.surrogate.surrogate import Surrogate

Floats = NDArray[np.float64]

PERIOD_S, DURATION_S = 0.01, 12.0
TUBE_S, VALVE_S = 0.03, 0.06
SOFTER = 0.95
FORGET_S = 0.15  # time constant of the correction
FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "control.png"


@dataclass
class Air:
    """The pressure in the finger, late behind the one that is asked for [kPa]."""

    kpa: float

    def __post_init__(self) -> None:
        self._tube = [self.kpa] * round(TUBE_S / PERIOD_S)

    def follow(self, asked_kpa: float) -> float:
        """The pressure one period later."""
        self._tube.append(asked_kpa)
        self.kpa += (self._tube.pop(0) - self.kpa) * (1 - np.exp(-PERIOD_S / VALVE_S))
        return self.kpa


@dataclass(frozen=True)
class Ride:
    """What happened: tips (T, 2) [mm], pressures asked for and in the finger (T,) [kPa], computing time (T,) [s]."""

    tips_mm: Floats
    asked_kpa: Floats
    kpa: Floats
    seconds: Floats


def ride(surrogate: Surrogate, plant: Callable[[float], Floats], targets_mm: Floats, feedback: bool) -> Ride:
    """Ask the finger to follow targets (T, 2) [mm]."""
    lead = round((TUBE_S + VALVE_S) / PERIOD_S)
    at = surrogate.at([surrogate.tip_mm])
    first = float(surrogate.pressure_for(tip=targets_mm[0]))
    air, expected_air = Air(first), Air(first)
    off, rows = np.zeros(2), []
    for k in range(len(targets_mm)):
        seen = plant(air.kpa)
        start = time.perf_counter()
        if feedback:
            expected = surrogate.tip_mm + at(expected_air.kpa)[0]
            off += (seen - expected - off) * (1 - np.exp(-PERIOD_S / FORGET_S))
        ahead = targets_mm[min(k + lead, len(targets_mm) - 1)]
        asked = float(surrogate.pressure_for(tip=ahead - off))
        expected_air.follow(asked)
        seconds = time.perf_counter() - start
        rows.append((*seen, asked, air.kpa, seconds))
        air.follow(asked)
    table = np.array(rows)
    return Ride(table[:, :2], table[:, 2], table[:, 3], table[:, 4])


def tip_of(made: Experiment, high_kpa: float) -> CubicSpline:
    """Place of the tip [mm] by pressure [kPa], by the finite elements."""
    snapshots, *_ = cache.simulate(made.finger, made.fem, made.observation, paths.RUNS / "snapshots")
    tip = snapshots.domain.base[-1]
    assert snapshots.pressures_kpa[-1] >= high_kpa
    return CubicSpline(snapshots.pressures_kpa, snapshots.domain.points_mm[tip] + snapshots.displacements[:, tip])


def main() -> None:
    """Ride twice, print the errors and draw them."""
    composing.store_choices()
    folder = stored_run(sys.argv[1] if len(sys.argv) > 1 else "runs/latest")
    surrogate = stored_surrogate(folder)
    known = Experiment.from_config(restore(folder / "config.yaml"))
    law = replace(known.finger.material, **{name: SOFTER * value for name, value in vars(known.finger.material).items()
                                            if name.endswith("_mpa")})  # fmt: skip
    softer = replace(known, finger=replace(known.finger, material=law), fem=replace(known.fem, estimate_error=False))
    top = known.finger.max_kpa
    plant, own = tip_of(softer, top), tip_of(known, top)

    t = np.arange(0, DURATION_S, PERIOD_S)
    wanted_kpa = top * np.where(t < 6, 0.45 - 0.3 * np.cos(2 * np.pi * t / 3), np.where(t < 9, 0.7, 0.35))
    settle = np.exp(-np.arange(0, 0.6, PERIOD_S) / 0.12)  # steps that air can follow
    wanted_kpa = np.convolve(np.pad(wanted_kpa, (len(settle) - 1, 0), mode="edge"), settle / settle.sum(), "valid")
    targets = own(wanted_kpa)
    grid = plant(np.linspace(0.01 * top, top, 4001))
    floor = np.array([np.linalg.norm(grid - target, axis=1).min() for target in targets])
    rides = {
        "surrogate alone": ride(surrogate, plant, targets, feedback=False),
        "with the tip seen": ride(surrogate, plant, targets, feedback=True),
    }
    errors = {name: np.linalg.norm(each.tips_mm - targets, axis=1) for name, each in rides.items()}
    for name, each in rides.items():
        error = errors[name]
        print(f"{name}: tip off by {np.sqrt((error**2).mean()):.2f} mm rms, {error.max():.2f} mm at most; "
              f"{1e6 * np.median(each.seconds):.0f} µs of computing per period, p99 "
              f"{1e6 * np.quantile(each.seconds, 0.99):.0f}")  # fmt: skip
    print(
        f"what no pressure can mend, as the softer finger takes another path: {np.sqrt((floor**2).mean()):.2f} mm rms"
    )
    draw(t, targets, rides, errors, floor, wanted_kpa)


def draw(t: Floats, targets: Floats, rides: dict[str, Ride], errors: dict[str, Floats], floor: Floats,
         wanted_kpa: Floats) -> None:  # fmt: skip
    """Path, errors and pressures."""
    figure, axes = plt.subplot_mosaic([["path", "error"], ["path", "air"]], figsize=(10, 5), width_ratios=[1, 1.5],
                                      layout="constrained")  # fmt: skip
    colours = {"surrogate alone": "tab:orange", "with the tip seen": "tab:blue"}
    axes["path"].plot(*targets.T, color="black", lw=5, alpha=0.25, label="target")
    for name, each in rides.items():
        axes["path"].plot(*each.tips_mm.T, color=colours[name], lw=1.2, label=name)
        axes["error"].plot(t, errors[name], color=colours[name], lw=1.2, label=name)
    axes["error"].plot(t, floor, color="gray", lw=1, ls="--", label="out of reach of the softer finger")
    axes["air"].plot(t, wanted_kpa, color="black", lw=5, alpha=0.25, label="pressure of the target")
    each = rides["with the tip seen"]
    axes["air"].plot(t, each.asked_kpa, color="tab:red", lw=1, label="asked for")
    axes["air"].plot(t, each.kpa, color="tab:blue", lw=1.2, label="in the finger")
    axes["path"].set(xlabel="tip x (mm)", ylabel="tip z (mm)", aspect="equal", title="Path of the tip")
    axes["error"].set(ylabel="tip off target (mm)", ylim=(0, None), title="Rubber 5 % softer than the surrogate's")
    axes["air"].set(xlabel="time (s)", ylabel="pressure (kPa)", title="Air that comes 90 ms late")
    axes["air"].set_ylim(0, 1.35 * wanted_kpa.max())
    for name, axis in axes.items():
        axis.legend(fontsize=8, frameon=False, **({"loc": "upper center", "ncols": 3} if name == "air" else {}))
        axis.grid(alpha=0.3)
    figure.savefig(FIGURE, dpi=150)


if __name__ == "__main__":
    main()
