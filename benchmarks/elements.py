"""The element chart: discretisation error against time, in a linear sag and at full pressure.

    python benchmarks/elements.py

Candidates are elements on hexahedra of 3 mm and finer, and the default element on meshes that are finer in one
direction only, or towards the re-entrant corners. `hex27_p0`, mean dilatation, is also F-bar: with an energy that is
split into isochoric and volumetric parts both are W_iso(F) + U(mean J).

Linear sag: the finger `pneunet` under its weight, per unit of gravity (a measure, not a displacement it ever has).
Full pressure: the same finger with three chambers at 50 kPa. References are the Richardson extrapolations of the
default element's two finest meshes, with the order that three meshes show. Every solve is kept in runs/elements and
not repeated; remove that folder to measure again. The figure is docs/figures/elements.png.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import digest, folders, kept, panels, parsed, parser, save, show, table
from pgdl_lab.mechanics.extrude import extrude
from pgdl_lab.mechanics.finger import ExtrudedFinger, Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.profile import Profile
from pgdl_lab.running.composing import experiment

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]

COARSE_MM = 3.0
REFINED = (1.0, 0.5, 1 / 3)  # edges of the default element's meshes, as multiples of the coarsest
DEFAULT = "hex27_p1"
NEWTON_MM, INTERPOLATION_MM = 1e-6, 1e-2
LABELS = (((-7, -3), "right"), ((7, -3), "left"), ((0, -14), "center"), ((0, 7), "center"))
"""Where the names of the layered and graded meshes stand beside their points: offset and alignment."""


@dataclass(frozen=True)
class Case:
    """An element on a mesh with edges of at most `edges_mm` along x, y and z, perhaps graded."""

    element: str
    edges_mm: tuple[float, float, float]
    graded: bool = False

    @property
    def label(self) -> str:
        """As the figure and the table call it."""
        edge = self.edges_mm
        if self.graded:
            return f"{self.element}, {edge[0]:g} mm, graded to corners"
        if len(set(edge)) == 1:
            return f"{self.element}, {edge[0]:g} mm"
        fine = next(axis for axis, length in zip("xyz", edge, strict=True) if length < max(edge))
        return f"{self.element}, {max(edge):g} mm, {min(edge):g} along {fine}"


@dataclass(frozen=True)
class Meshed:
    """A finger that is meshed as a case says; all else is the finger's."""

    finger: ExtrudedFinger
    case: Case

    def __getattr__(self, name: str) -> Any:
        return getattr(self.finger, name)

    def mesh(self, edge_mm: float) -> "Mesh":
        """Mesh a stretched finger evenly and shrink it back, so that each direction has an edge length of its own."""
        stretch = edge_mm / np.array(self.case.edges_mm)
        profile, half = self.finger.profile(), self.finger.width_mm / 2
        wide = Profile(profile.x * stretch[0], profile.z * stretch[2], profile.regions)
        mesh = extrude(wide, half * stretch[1], self.finger.side_wall_mm * stretch[1], edge_mm)
        points = mesh.p / stretch[:, None]
        if self.case.graded:
            lines = (profile.x, np.array([0.0, half - self.finger.side_wall_mm, half]), profile.z)
            points = np.stack([grade(values, axis) for values, axis in zip(points, lines, strict=True)])
        named = dict(mesh.boundaries)
        graded: Mesh = type(mesh)(points, mesh.t).with_boundaries(named)
        return graded


def meshed(case: Case, *choices: str) -> Finger:
    """The reference finger with other `choices`, to be meshed as `case` says."""
    finger = experiment(["finger=pneunet_reference", *choices]).finger
    return cast(Finger, Meshed(cast(ExtrudedFinger, finger), case))


def grade(values: Array, lines: Array) -> Array:
    """Move `values` between `lines` towards the nearer one: where corners are, elements get smaller."""
    place = np.clip(np.searchsorted(lines, values, side="right") - 1, 0, len(lines) - 2)
    start, length = lines[place], np.diff(lines)[place]
    part = (values - start) / length
    return start + length * (part - np.sin(2 * np.pi * part) / (2 * np.pi) * 0.6)


def cases(coarse_mm: float) -> list[Case]:
    """All candidates, on meshes with edges of `coarse_mm` and finer."""
    coarse, middle, fine = (coarse_mm * part for part in REFINED)
    even = [Case(element, (edge,) * 3) for element in ("hex20", "hex27", "hex27_p0") for edge in (coarse, middle)]
    finer_along = [(middle, coarse, coarse), (coarse, middle, coarse), (coarse, coarse, middle)]
    layered = [Case(DEFAULT, edges) for edges in finer_along]
    return [*even, *layered, Case(DEFAULT, (fine,) * 3, graded=True), *evenly(coarse_mm)]


def evenly(coarse_mm: float) -> list[Case]:
    """The default element on even meshes, the coarsest first."""
    return [Case(DEFAULT, (coarse_mm * part,) * 3) for part in REFINED]


def tip(model: Model) -> int:
    """The node at the lower outer corner of the end."""
    corner = model.mesh.p.max(axis=1) * [1, 1, 0]
    return int(np.linalg.norm(model.discretisation.positions - corner, axis=1).argmin())


def linear_sag(case: Case) -> tuple[list[float], int]:
    """Displacement of the tip [mm] in a linear solve under the weight, and the number of unknowns."""
    model = Model(meshed(case), COARSE_MM, case.element)
    sag, free = np.zeros_like(model.discretisation.positions), model.equilibrium.free
    balance = model.equilibrium.balance(sag, {"weight": 1.0}, stiffness=True)
    assert balance.stiffness is not None
    model.solver.factorise(balance.stiffness)
    sag[free] = -model.solver.solve(balance.forces[free])
    model.solver.close()
    return sag[tip(model), [0, 2]].tolist(), int(free.sum())


def full_pressure(case: Case) -> tuple[list[float], int]:
    """Displacement of the tip [mm] at the highest pressure, and the number of unknowns."""
    finger = meshed(case, "finger.chambers=3")
    model = Model(finger, COARSE_MM, case.element)
    history = model.load(np.array([finger.max_kpa]), NEWTON_MM, INTERPOLATION_MM)
    return history.branch.displacements[-1][tip(model), [0, 2]].tolist(), int(model.equilibrium.free.sum())


SCENES: dict[str, Callable[[Case], tuple[list[float], int]]] = {
    "linear sag": linear_sag,
    "full pressure": full_pressure,
}


def measured(scene: str, case: Case) -> dict[str, Any]:
    """Tip [mm], unknowns and wall time [s] of a case, solved now."""
    began = time.perf_counter()
    place, unknowns = SCENES[scene](case)
    return {"tip_mm": place, "unknowns": unknowns, "seconds": time.perf_counter() - began}


def extrapolated(values: Array, edges_mm: tuple[float, ...]) -> tuple[Array, float]:
    """Richardson's limit of the displacements (3, 2) on three meshes, and the order that the last two steps show."""
    coarse, middle, fine = values
    steps = np.linalg.norm(coarse - middle), np.linalg.norm(middle - fine)
    orders = np.linspace(0.5, 6, 5501)
    h = np.array(edges_mm)[:, None] ** orders
    order = float(orders[np.abs((h[0] - h[1]) / (h[1] - h[2]) - steps[0] / steps[1]).argmin()])
    part = edges_mm[2] ** order / (edges_mm[1] ** order - edges_mm[2] ** order)
    return fine + part * (fine - middle), order


def main() -> None:
    """Measure what is not in the store, print the tables, draw the figure."""
    arguments = parser(__doc__)
    arguments.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    arguments.add_argument("--edge-mm", type=float, default=COARSE_MM, help="longest edges of the coarsest meshes")
    given = parsed(arguments, edge_mm=9.0, scenes=["full pressure"])
    (store, docs), charts = folders("elements", given.quick), {}
    for scene in given.scenes:
        rows = {}
        for case in cases(given.edge_mm):
            found = kept(store / f"{digest([scene, case.label])}.json", partial(measured, scene, case))
            assert found is not None
            rows[case.label] = case, found
        even = evenly(given.edge_mm)
        series = np.array([rows[case.label][1]["tip_mm"] for case in even])
        reference, order = extrapolated(series, tuple(case.edges_mm[0] for case in even))
        shown = table(
            f"{scene}: reference u_x {reference[0]:.3f}, u_z {reference[1]:.3f} mm (order {order:.1f})",
            ("element and mesh", "unknowns", "u_x (mm)", "u_z (mm)", "error (%)", "time (s)"),
        )
        chart = []
        for label, (case, row) in rows.items():
            error = 100 * float(np.linalg.norm(row["tip_mm"] - reference) / np.linalg.norm(reference))
            x, z = row["tip_mm"]
            seconds = f"{row['seconds']:.2f}"
            shown.add_row(label, f"{row['unknowns']:,}", f"{x:.3f}", f"{z:.3f}", f"{error:.2f}", seconds)
            chart.append((case, row["seconds"], error))
        show(shown)
        charts[scene] = chart
    draw(charts, docs / "figures" / "elements.png")


def draw(charts: dict[str, list[tuple[Case, float, float]]], path: Path) -> None:
    """Error over time, one panel for each scene; lines join the meshes of an element."""
    figure, axes = panels(1, len(charts), (11, 4.6), squeeze=False)
    for panel, (scene, chart) in zip(axes[0], charts.items(), strict=True):
        for number, element in enumerate(dict.fromkeys(case.element for case, *_ in chart)):
            even = [(s, e) for case, s, e in chart if case.element == element and case.label.count(",") == 1]
            panel.plot(*zip(*sorted(even), strict=True), "o-", color=f"C{number}", label=element)
            other = [(c, s, e) for c, s, e in chart if c.element == element and c.label.count(",") > 1]
            for (case, seconds, error), (offset, side) in zip(other, LABELS, strict=False):
                panel.plot(seconds, error, "s", color=f"C{number}", mfc="white", zorder=3)
                short = "graded" if case.graded else case.label.split(", ")[-1]
                panel.annotate(short, (seconds, error), textcoords="offset points", xytext=offset, fontsize=8, ha=side)
        panel.axhline(2, color="0.6", lw=0.8, ls=":")
        panel.set(xscale="log", yscale="log", title=scene, xlabel="time (s)", ylabel="error of the tip (%)")
        panel.grid(alpha=0.3, which="both")
        panel.margins(0.12)
    lines, labels = axes[0, -1].get_legend_handles_labels()
    figure.legend(lines, labels, title="edges 3, 1.5 (and 1) mm", loc="outside right upper", frameon=False)
    save(figure, path, dpi=160)


if __name__ == "__main__":
    main()
