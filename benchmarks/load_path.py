"""The load path of the reference finger: gravity and 100 sub-steps of pressure, beside 100 equilibria solved for.

    python benchmarks/load_path.py [--element hex20 hex27_p1] [--edge-mm 3]

The finger is `pneunet_reference` to 50 kPa. The time is that from the meshed finger to all sub-steps, on however many
cores there are. Then every sub-step is solved for by itself, from the interpolated displacement and to a tolerance a
hundred times smaller, and the largest distance of any node is taken.
"""

import time

import numpy as np

from benchmarks.common import parsed, parser, print_load, show, table
from benchmarks.scenes import scene
from pgdl_lab.core import registry
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.newton import solve

EXACT = 1e-2  # of the tolerance of the path


def row(finger: Finger, element: str, edge_mm: float, sub_steps: int) -> list[str]:
    """One line of the table."""
    solid = registry.plugin("fem", "solid")()
    pressures = Observation(snapshots=sub_steps).pressures_kpa(finger.max_kpa)
    model = Model(finger, edge_mm, element)
    began = time.perf_counter()
    history = model.load(pressures, solid.newton_mm, solid.interpolation_mm)
    snapshots = [history.at(kpa) for kpa in pressures]
    path_s = time.perf_counter() - began
    began, worst, iterations = time.perf_counter(), 0.0, 0
    for kpa, known in zip(pressures, snapshots, strict=True):
        exact = solve(model.equilibrium, model.solver, known, model.amplitudes(kpa), EXACT * solid.newton_mm)
        worst = max(worst, float(np.linalg.norm(exact.displacement - known, axis=1).max()))
        iterations += exact.iterations
    checked_s = time.perf_counter() - began
    return [
        element, f"{int(model.equilibrium.free.sum()):,}", str(len(history.branch.parameters)),
        str(history.iterations), f"{path_s:.1f}", f"{history.interpolation_mm:.1e}", f"{worst:.1e}",
        f"{checked_s:.1f} ({iterations})",
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--element", nargs="+", default=["hex20", "hex27_p1"])
    arguments.add_argument("--edge-mm", type=float, default=3.0)
    arguments.add_argument("--sub-steps", type=int, default=100)
    given = parsed(arguments, edge_mm=6.0, sub_steps=10)
    finger = scene("pneunet_reference", quick=given.quick).finger
    headings = (
        "element", "degrees of freedom", "equilibria", "Newton iterations", "time (s)", "estimated error (mm)",
        "largest error (mm)", f"{given.sub_steps} solves (s) (iterations)",
    )  # fmt: skip
    shown = table(f"Gravity and {given.sub_steps} sub-steps to 50 kPa, edges of {given.edge_mm:g} mm", headings)
    for element in given.element:
        shown.add_row(*row(finger, element, given.edge_mm, given.sub_steps))
    show(shown)
    print_load()


if __name__ == "__main__":
    main()
