"""Whether the charts' reference is as sure as it says: beside a simulation finer than both of its meshes.

    python benchmarks/reference.py --finger joints --edge 0.9

The reference of `task=chart` is extrapolated from edges of 3 and 1.5 mm, and its band is half or all of their distance.
Both meshes and the extrapolation are compared with one more simulation, at the same points and pressures.
Simulations are kept in runs/snapshots as those of any run.
"""

import argparse
from typing import Any

from rich.console import Console
from rich.table import Table

from pgdl_lab.core import paths
from pgdl_lab.core.registry import plugin
from pgdl_lab.running import cache
from pgdl_lab.running.composing import composed
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.chart.bench import Bench
from pgdl_lab.studies.chart.reference import Errors
from pgdl_lab.tasks.chart import chart_settings


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="The reference of the charts beside a finer simulation.")
    parser.add_argument("--finger", default="joints")
    parser.add_argument("--edge", type=float, default=0.9, help="longest edges of the finer mesh [mm]")
    given = parser.parse_args()
    config = composed([f"finger={given.finger}", "task=chart"])
    experiment, settings = Experiment.from_config(config), chart_settings(config)
    bench = Bench(experiment, settings, paths.RUNS)
    reference, judged = bench.reference, settings.judgement(experiment.observation)
    fields: dict[str, Any] = {**settings.reference, "edge_mm": given.edge}
    finer, *_ = cache.simulate(
        experiment.finger, plugin("fem", fields.pop("name"))(**fields), judged, bench.folder / "snapshots"
    )

    unknowns = f"{finer.provenance['mesh']['degrees_of_freedom']:,} unknowns, {finer.provenance['seconds']:.0f} s"
    table = Table(title=f"{given.finger}: distance from edges of {given.edge:g} mm ({unknowns}), mm")
    for column in ("", "RMS", "largest", "tip"):
        table.add_column(column, justify="right" if column else "left")
    rows = {f"edges of {edge:g} mm": each.displacements
            for edge, each in zip(reference.edges_mm, (reference.coarse, reference.fine), strict=True)}  # fmt: skip
    for name, displacements in {**rows, "extrapolated": reference.displacements}.items():
        errors = Errors.of(displacements - finer.displacements, reference.tip)
        table.add_row(name, *_cells(errors))
    table.add_row("band of the reference", *_cells(reference.uncertainty))
    Console(width=110).print(table)


def _cells(errors: Errors) -> tuple[str, str, str]:
    return f"{errors.rms_mm:.3f}", f"{errors.largest_mm:.3f}", f"{errors.tip_mm:.3f}"


if __name__ == "__main__":
    main()
