"""Whether the charts' reference is as sure as it says: beside a simulation finer than both of its meshes.

    python benchmarks/reference.py --finger joints --edge 0.9

The reference of `task=chart` is extrapolated from edges of 3 and 1.5 mm, and its band is half or all of their distance.
Both meshes and the extrapolation are compared with one more simulation, at the same points and pressures.
Simulations are kept in runs/snapshots as those of any run.
"""

from dataclasses import replace
from typing import Any

from benchmarks.common import parsed, parser, show, table
from benchmarks.scenes import COARSE, SMALL, simulated
from pgdl_lab.core import paths
from pgdl_lab.core.registry import plugin
from pgdl_lab.running.composing import composed
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.chart.bench import Bench
from pgdl_lab.studies.chart.reference import Errors
from pgdl_lab.tasks.chart import chart_settings


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--finger", default="joints")
    arguments.add_argument("--edge", type=float, default=0.9, help="longest edges of the finer mesh [mm]")
    given = parsed(arguments, finger="pneunet", edge=2.5)
    small = [*SMALL[given.finger], *COARSE] if given.quick else []
    config = composed([f"finger={given.finger}", "task=chart", *small])
    made, settings = Experiment.from_config(config), chart_settings(config)
    settings = settings.quick() if given.quick else settings
    reference = Bench(made, settings, paths.RUNS).reference
    fields: dict[str, Any] = {**settings.reference, "edge_mm": given.edge}
    fem = plugin("fem", fields.pop("name"))(**fields)
    finer = simulated(replace(made, fem=fem, observation=settings.judgement(made.observation)))

    unknowns = f"{finer.provenance['mesh']['degrees_of_freedom']:,} unknowns, {finer.provenance['seconds']:.0f} s"
    title = f"{given.finger}: distance from edges of {given.edge:g} mm ({unknowns}), mm"
    shown = table(title, ("", "RMS", "largest", "tip"))
    rows = {f"edges of {edge:g} mm": each.displacements
            for edge, each in zip(reference.edges_mm, (reference.coarse, reference.fine), strict=True)}  # fmt: skip
    for name, displacements in {**rows, "extrapolated": reference.displacements}.items():
        errors = Errors.of(displacements - finer.displacements, reference.tip)
        shown.add_row(name, *_cells(errors))
    shown.add_row("band of the reference", *_cells(reference.uncertainty))
    show(shown)


def _cells(errors: Errors) -> tuple[str, str, str]:
    return f"{errors.rms_mm:.3f}", f"{errors.largest_mm:.3f}", f"{errors.tip_mm:.3f}"


if __name__ == "__main__":
    main()
