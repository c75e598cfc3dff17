"""Our solid beside CalculiX: same mesh, same element, same snapshots, one after the other in this process.

    python benchmarks/fem_peers.py --kpa 30 --edge-mm 3

The finger is `pneunet` with its default dimensions, from gravity up to the pressure given. Both use 20-node hexahedra
with 2×2×2 points; differences are taken over all points of the side face at all pressures. Differences of extremes are
related to the largest displacement along the same axis.
"""

import os
import shutil
import time
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from benchmarks import common, scenes
from pgdl_lab.core import registry
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics import calculix  # noqa: F401 (imported, with all it needs, before any time is taken)
from pgdl_lab.mechanics.calculix_program import PROGRAM, version
from pgdl_lab.mechanics.fem import Fem, SimulationStopped
from pgdl_lab.mechanics.finger import Finger


@dataclass(frozen=True)
class Timed:
    """Snapshots, and the wall and processor time [s] they took."""

    snapshots: Dataset
    wall_s: float
    cpu_s: float


def timed(fem: Fem, finger: Finger, observation: Observation) -> Timed:
    """Simulate; what converged counts if the simulation stops early."""
    wall, cpu = time.perf_counter(), _cpu_s()
    try:
        snapshots = fem.simulate(finger, observation)
    except SimulationStopped as stop:
        print(stop)
        snapshots = stop.snapshots
    return Timed(snapshots, time.perf_counter() - wall, _cpu_s() - cpu)


def _cpu_s() -> float:
    """Processor time of this process and its children [s]."""
    return sum(os.times()[:4])


def compare(ours: Timed, theirs: Timed) -> Table:
    """Extremes at the highest common pressure, differences over all common ones, and times."""
    count = min(len(ours.snapshots.pressures_kpa), len(theirs.snapshots.pressures_kpa))
    a, b = ours.snapshots.displacements[:count], theirs.snapshots.displacements[:count]
    title = f"Gravity to {ours.snapshots.pressures_kpa[count - 1]:g} kPa, {count} snapshots"
    title += f", {ours.snapshots.provenance['mesh']['nodes']:,} nodes"
    table = common.table(title, ("", "solid hex20", f"CalculiX {version()}", "difference", "relative"))
    for component, name in enumerate(("u_x", "u_z")):
        largest = np.abs(a[-1, :, component]).max()
        for label, extreme in (("min", np.min), ("max", np.max)):
            mine, other = extreme(a[-1, :, component]), extreme(b[-1, :, component])
            share = f"{abs(mine - other) / largest:.3%}"
            table.add_row(f"{name} {label} (mm)", f"{mine:.3f}", f"{other:.3f}", f"{mine - other:.3f}", share)
    distance, size = np.linalg.norm(a - b, axis=2), np.linalg.norm(a, axis=2)
    worst, mean = distance.max(), np.sqrt((distance**2).mean())
    table.add_row("largest distance (mm)", "", "", f"{worst:.4f}", f"{worst / size.max():.3%}")
    table.add_row("rms distance (mm)", "", "", f"{mean:.4f}", f"{mean / size.max():.3%}")
    table.add_section()
    for name, mine, other in (
        ("wall time (s)", ours.wall_s, theirs.wall_s),
        ("processor time (s)", ours.cpu_s, theirs.cpu_s),
        ("iterations", *(run.snapshots.provenance["newton_iterations"] for run in (ours, theirs))),
    ):
        table.add_row(name, f"{mine:.4g}", f"{other:.4g}", "", f"{other / mine:.1f}×")
    return table


def main() -> None:
    """Run both and print the table."""
    arguments = common.parser(__doc__)
    arguments.add_argument("--kpa", type=float, default=30.0, help="highest pressure")
    arguments.add_argument("--edge-mm", type=float, default=3.0, help="longest element edge")
    arguments.add_argument("--snapshots", type=int, default=30, help="number of equal pressure sub-steps")
    given = common.parsed(arguments, kpa=5.0, edge_mm=6.0, snapshots=3)
    if shutil.which(PROGRAM) is None:
        common.skip("CalculiX", "Debian's calculix-ccx")
    finger = scenes.scene("pneunet_reference", f"finger.max_kpa={given.kpa}", quick=given.quick).finger
    observation = Observation(snapshots=given.snapshots)
    solid = registry.plugin("fem", "solid")(edge_mm=given.edge_mm, element="hex20", estimate_error=False)
    peer = registry.plugin("fem", "calculix")(edge_mm=given.edge_mm)
    common.show(compare(timed(solid, finger, observation), timed(peer, finger, observation)))
    common.print_load()


if __name__ == "__main__":
    main()
