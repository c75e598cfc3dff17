"""How well the load path knows its own error where the path has a kink, as where surfaces meet.

    python benchmarks/kinks.py [--trials 1000]

Each trial is an arc of radius 50 mm that is left, from a random place on, by a power of the way beyond it: the
derivative of that order jumps, by 0.001 to 1 mm per unit to that power. The arc is known in closed form, so every
snapshot can be held against it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import parsed, parser, show, table
from pgdl_lab.mechanics.newton import Solution
from pgdl_lab.mechanics.path import follow, refine

Array = NDArray[np.float64]

STOP, FIRST_STEP, TOLERANCE_MM = 50.0, 2.0, 1e-5
SNAPSHOTS, ORDERS = (100, 500), (1, 2, 3)


@dataclass
class KinkedArc:
    """The arc, left from `kink` on by `size` (x − kink)^`order` in each component."""

    kink: float
    size: float
    order: int

    def exact(self, x: float) -> Array:
        """Displacement (1, 3) [mm]."""
        return (
            50 * np.array([[np.sin(x / 20), 0.0, np.cos(x / 20)]]) + self.size * max(0.0, x - self.kink) ** self.order
        )

    def solve(self, start: Array, parameter: float) -> Solution:
        """As a leg does, from anywhere."""
        return Solution(self.exact(parameter), 1, 0.0)

    def slope(self, solution: Solution, parameter: float) -> Array:
        """As a leg does."""
        beyond = parameter - self.kink
        leaving = self.size * self.order * beyond ** (self.order - 1) if beyond > 0 else 0.0
        return 2.5 * np.array([[np.cos(parameter / 20), 0.0, -np.sin(parameter / 20)]]) + leaving


def row(order: int, snapshots: int, trials: int) -> list[str]:
    """One line of the table."""
    random, wanted = np.random.default_rng(0), np.linspace(STOP / snapshots, STOP, snapshots)
    above, worst, equilibria = 0, 0.0, 0
    for _ in range(trials):
        leg = KinkedArc(random.uniform(0, STOP), 10 ** random.uniform(-3, 0) * random.choice([-1, 1]), order)
        branch = follow(leg, leg.exact(0.0), STOP, FIRST_STEP, lambda _: None)
        bound = max(TOLERANCE_MM, refine(leg, branch, wanted, TOLERANCE_MM))
        error = max(float(np.abs(branch.at(x) - leg.exact(x)).max()) for x in wanted)
        above, worst, equilibria = (
            above + (error > bound),
            max(worst, error / bound),
            equilibria + len(branch.parameters),
        )
    return [str(order), str(snapshots), f"{above} of {trials}", f"{worst:.2g}", f"{equilibria / trials:.1f}"]


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=1000)
    given = parsed(arguments, trials=20)
    headings = (
        "derivative that jumps",
        "snapshots",
        "error above the bound",
        "largest error over the bound",
        "equilibria",
    )
    shown = table(f"Random kinks, interpolation to {TOLERANCE_MM:g} mm", headings, left=0)
    for order in ORDERS:
        for snapshots in SNAPSHOTS:
            shown.add_row(*row(order, snapshots, given.trials))
    show(shown)


if __name__ == "__main__":
    main()
