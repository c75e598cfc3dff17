"""The estimated discretisation error of every finger beside the true one, from one much finer solve each.

    python benchmarks/discretisation.py

For each finger the default mesh (fem.edge_mm=3) and one with half the edges, eight times as many elements. Dataset
are kept in runs/snapshots as those of any run; the finer ones take minutes each. Errors are displacement differences
at the end of the base line. The figure is docs/figures/discretisation.png.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import folders, panels, parsed, parser, save, show, table
from benchmarks.scenes import scene, simulated
from pgdl_lab.core.dataset import Dataset

FINGERS = ("joints", "bellows", "pneunet", "pneunet_reference")


@dataclass(frozen=True)
class Result:
    """What one finger shows.

    Attributes
    ----------
    kpa, tip_mm, moved_mm
        (P,) pressures [kPa], distance of the tips of both meshes and displacement of the tip [mm].
    estimate
        Of the coarse mesh at the highest pressure, from its provenance.
    seconds
        Time of the coarse and of the fine simulation [s].
    """

    kpa: NDArray[np.float64]
    tip_mm: NDArray[np.float64]
    moved_mm: NDArray[np.float64]
    estimate: dict[str, Any]
    seconds: tuple[float, float]

    @classmethod
    def of(cls, coarse: Dataset, fine: Dataset) -> "Result":
        tip = coarse.domain.base[-1]
        difference = np.linalg.norm(coarse.displacements[:, tip] - fine.displacements[:, tip], axis=1)
        moved = np.linalg.norm(fine.displacements[:, tip], axis=1)
        times = coarse.provenance["seconds"], fine.provenance["seconds"]
        return cls(coarse.pressures_kpa, difference, moved, coarse.provenance["discretisation_error"], times)


def main() -> None:
    """Simulate what is not in the cache, print the table, draw the figure."""
    arguments = parser(__doc__)
    arguments.add_argument("fingers", nargs="*", default=FINGERS)
    given = parsed(arguments, fingers=["pneunet"])
    results = {}
    for name in given.fingers:
        made = scene(name, "fem.estimate_error=true", quick=given.quick)
        solid: Any = made.fem
        finer = replace(solid, edge_mm=solid.edge_mm / 2, estimate_error=False)
        results[name] = Result.of(*(simulated(replace(made, fem=fem)) for fem in (solid, finer)))
    headings = ("finger", "kPa", "difference (mm)", "(%)", "estimate (mm)", "(%)", "time (s)", "fine (s)")
    shown = table("Tip at the highest pressure: default mesh against half the edges", headings)
    for name, result in results.items():
        true, percent = result.tip_mm[-1], 100 * result.tip_mm[-1] / result.moved_mm[-1]
        estimate = (f"{result.estimate['tip_mm']:.2f}", f"{result.estimate['tip_percent']:.2f}")
        times = (f"{seconds:.1f}" for seconds in result.seconds)
        shown.add_row(name, f"{result.kpa[-1]:g}", f"{true:.2f}", f"{percent:.2f}", *estimate, *times)
    show(shown)
    draw(results, folders("discretisation", given.quick)[1] / "figures" / "discretisation.png")


def draw(results: dict[str, Result], path: Path) -> None:
    """True error over the pressure, and its estimate at the end."""
    figure, panel = panels(1, 1, (7, 4.4))
    for number, (name, result) in enumerate(results.items()):
        highest, colour = result.kpa[-1], f"C{number}"
        percent = 100 * result.tip_mm / result.moved_mm[-1]
        panel.plot(100 * result.kpa / highest, percent, color=colour, label=f"{name}, to {highest:g} kPa")
        panel.plot(100, result.estimate["tip_percent"], "o", color=colour, mfc="white", clip_on=False, zorder=3)
    panel.plot([], [], "o", color="0.4", mfc="white", label="estimate")
    panel.axhline(2, color="0.6", lw=0.8, ls=":")
    panel.set(xlim=(0, 100), ylim=(0, None), xlabel="pressure (% of the highest)")
    panel.set_ylabel("tip, 3 mm against 1.5 mm edges\n(% of its way at the highest pressure)")
    panel.legend()
    panel.grid(alpha=0.3)
    save(figure, path, dpi=160)


if __name__ == "__main__":
    main()
