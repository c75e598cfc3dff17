"""A thin-walled finger whose chambers touch, with contact and without, and what watching for contact costs.

    python benchmarks/contact.py [--figure docs/figures/contact.png] [--overhead]

The finger is `pneunet` with walls of 1.5 mm and gaps of 0.5 mm, to its full pressure. At each of 100 snapshots surfaces
are tested for crossings, and the smallest distance between them is taken. What watching costs is measured on the
default finger and mesh, where nothing touches: the processor time of all looks for contact in that of the run, and the
processor time of `fem.contact=auto` over that of `fem.contact=off`, medians of alternating runs.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, cast
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import folders, panels, parsed, parser, save, show, table
from benchmarks.scenes import scene
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.collision import collision_mesh
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.skin import sampled, skin
from pgdl_lab.running.experiment import Experiment

Array = NDArray[np.float64]

EDGE_MM, REACH_MM, NEWTON_MM = 6.0, 0.05, 1e-6
INTERPOLATION_MM = 1e-2  # of the finger that touches itself: each place that comes in touch is a kink in its path
OBSERVATION = Observation()
SHOWN = 39  # the snapshot drawn: 20 kPa
MIDDLE_OF_GAP_MM = (87.75, 0.0, 9.9)  # at rest, between the eighth chamber and the ninth
THIN = ("finger.wall_mm=1.5", "finger.side_wall_mm=1.5", "finger.gap_mm=0.5")
"""What is typed for the finger whose chambers touch."""


@dataclass(frozen=True)
class Inflation:
    """What became of the thin-walled finger.

    Attributes
    ----------
    model
        Its mesh and equilibrium.
    seconds
        Time of the load path [s].
    equilibria, iterations
        How many of each.
    interpolation_mm
        Largest estimated error between the equilibria [mm].
    pressures_kpa
        Of the snapshots reached [kPa].
    displacements
        (N, 3) each [mm].
    gaps_mm
        Smallest distance between surfaces [mm]; infinite where they are far apart.
    crossed
        Whether surfaces cross.
    """

    model: Model
    seconds: float
    equilibria: int
    iterations: int
    interpolation_mm: float
    pressures_kpa: Array
    displacements: Sequence[Array]
    gaps_mm: Array
    crossed: NDArray[np.bool_]


def inflate(finger: Finger, mode: str) -> Inflation:
    """Weight and pressure on the thin-walled finger with contact in `mode`."""
    model = Model(finger, EDGE_MM, "auto", mode, REACH_MM)
    began = time.perf_counter()
    pressures = OBSERVATION.pressures_kpa(finger.max_kpa)
    history = model.load(pressures, NEWTON_MM, INTERPOLATION_MM)
    seconds = time.perf_counter() - began
    pressures = pressures[pressures <= history.reached_kpa * (1 + 1e-12)]
    displacements = [history.at(kpa) for kpa in pressures]
    contact = model.contact
    return Inflation(
        model,
        seconds,
        len(history.branch.parameters),
        history.iterations,
        history.interpolation_mm,
        pressures,
        displacements,
        np.array([contact.gap_mm(displacement) for displacement in displacements]),
        np.array([contact.penetrates(displacement) for displacement in displacements]),
    )


@dataclass
class Overhead:
    """Processor time of the default finger on its default mesh, where nothing touches, medians [s].

    Attributes
    ----------
    off, auto
        Of mesh and load path with contact `off` and `auto`, in alternation.
    watching
        Of what the second spent in looking for contact.
    """

    off: float
    auto: float
    watching: float


@contextmanager
def clocked(kind: type, names: Sequence[str]) -> Iterator[list[float]]:
    """Processor times [s] of all calls of the methods `names` of `kind`."""
    times: list[float] = []

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            began = time.process_time()
            try:
                return method(*arguments, **named)
            finally:
                times.append(time.process_time() - began)

        return call

    with ExitStack() as stack:
        for name in names:
            stack.enter_context(patch.object(kind, name, timed(getattr(kind, name))))
        yield times


def overhead(made: Experiment, repeats: int) -> Overhead:
    """Repeat the load path by turns."""
    finger, solid = made.finger, cast(Any, made.fem)
    taken: dict[str, list[float]] = {"off": [], "auto": []}
    watching = []
    for _ in range(repeats):
        for mode, times in taken.items():
            with clocked(Contact, ("__init__", "near", "passes")) as spent:
                began = time.process_time()
                model = Model(finger, solid.edge_mm, solid.element, mode, solid.contact_mm)
                model.load(OBSERVATION.pressures_kpa(finger.max_kpa), solid.newton_mm, solid.interpolation_mm)
                times.append(time.process_time() - began)
            if mode == "auto":
                watching.append(sum(spent))
    return Overhead(median(taken["off"]), median(taken["auto"]), median(watching))


def draw(inflations: dict[str, Inflation], path: Path) -> None:
    """The gap over the pressure, and two chambers in the plane of symmetry where they press on each other."""
    from matplotlib.collections import LineCollection

    figure, axes = panels(1, 3, (13, 4))
    touching = inflations["auto"]
    axes[0].plot(touching.pressures_kpa, touching.gaps_mm, color="tab:blue", label="contact=auto")
    for mode, inflation in inflations.items():
        crossed = inflation.pressures_kpa[inflation.crossed]
        if len(crossed):
            axes[0].axvspan(
                crossed[0], crossed[-1], color="tab:red", alpha=0.15, label=f"contact={mode}: surfaces cross"
            )
    axes[0].axhline(REACH_MM, color="black", linestyle=":", label="reach of contact")
    axes[0].set(xlabel="pressure [kPa]", ylabel="smallest gap [mm]", ylim=(0, None), title="Smallest gap")
    axes[0].legend(loc="lower left")
    for axis, (mode, inflation) in zip(axes[1:], inflations.items(), strict=True):
        discretisation, displacement = inflation.model.discretisation, inflation.displacements[SHOWN]
        surface = collision_mesh(sampled(np.concatenate(skin(discretisation)), discretisation.positions, 8))
        outline = surface.edges[(surface.rest_positions[surface.edges][:, :, 1] < 1e-9).all(axis=1)]
        at = surface.displace_vertices(np.asfortranarray(displacement))[:, [0, 2]]
        axis.add_collection(LineCollection(list(at[outline]), colors="0.2", linewidths=1.2))
        away = np.linalg.norm(surface.rest_positions - MIDDLE_OF_GAP_MM, axis=1)
        centre = at[np.argsort(away)[:2]].mean(axis=0)
        axis.set(xlim=centre[0] + np.array([-3, 3]), ylim=centre[1] + np.array([-3, 3]), aspect="equal")
        axis.set(
            xlabel="x [mm]",
            ylabel="z [mm]",
            title=f"Two chambers, contact={mode}, {inflation.pressures_kpa[SHOWN]:g} kPa",
        )
    save(figure, path, dpi=150)


def main() -> None:
    """Simulate, print and draw."""
    arguments = parser(__doc__)
    arguments.add_argument("--figure", type=Path, help="where it goes, if not to docs/figures/contact.png")
    arguments.add_argument("--overhead", action="store_true", help="only what watching costs")
    arguments.add_argument("--repeats", type=int, default=3, help="of what watching costs")
    given = parsed(arguments, repeats=1)
    if not given.overhead:
        finger = scene("pneunet_reference", *THIN, quick=given.quick).finger
        inflations = {mode: inflate(finger, mode) for mode in ("auto", "off")}
        what = (
            "reached kPa", "equilibria", "iterations", "between mm", "time s", "snapshots that cross", "least gap mm",
        )  # fmt: skip
        shown = table("", ("contact", *what), left=1 + len(what))
        for mode, inflation in inflations.items():
            shown.add_row(
                mode, f"{inflation.pressures_kpa[-1]:g}", str(inflation.equilibria), str(inflation.iterations),
                f"{inflation.interpolation_mm:.2g}", f"{inflation.seconds:.0f}",
                f"{inflation.crossed.sum()} of {len(inflation.crossed)}", f"{inflation.gaps_mm.min():.4f}",
            )  # fmt: skip
        show(shown)
        draw(inflations, given.figure or folders("contact", given.quick)[1] / "figures" / "contact.png")
    report(overhead(scene("pneunet", quick=given.quick), given.repeats))


def report(times: Overhead) -> None:
    """Print what watching costs, by the clock of its calls and by that of the whole."""
    print(
        f"default finger, nothing touches, processor time: off {times.off:.2f} s, auto {times.auto:.2f} s, "
        f"ratio {times.auto / times.off:.3f}; watching {times.watching:.3f} s, {times.watching / times.auto:.2%}"
    )


if __name__ == "__main__":
    main()
