"""The load path: equilibria followed with adaptive steps, and known between them by controlled interpolation.

An ODE solver with dense output has the same parts: a predictor of high order, steps sized by its error, and an
interpolant that is part of the solution. Here the predictor is corrected to the equilibrium by Newton's method, so
errors do not add up along the path.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import LabError
from pgdl_lab.mechanics.hermite import hermite
from pgdl_lab.mechanics.newton import NoConvergence, Solution

Array = NDArray[np.float64]

NODES = 4  # equilibria that predictor and interpolant use: polynomials of degree 7
PREDICTOR_ERROR_MM = 0.3  # what Newton's method mends in some three iterations
SMALLEST_STEP = 1e-5  # as a fraction of the path
SMALLEST_INTERVAL = 1e-4  # of the path: what is nearer to an equilibrium needs none of its own
LARGEST_STEP = 0.16
LIMIT_AHEAD = 1e-3  # of the path: a limit point farther off is not why no equilibrium is found
GROWTH = 2.0


class Leg(Protocol):
    """One leg of a load path, driven by a parameter: the weight or the pressure."""

    def solve(self, start: Array, parameter: float) -> Solution:
        """The equilibrium at `parameter`, from the displacement `start` (N, 3) [mm]; raises NoConvergence."""

    def slope(self, solution: Solution, parameter: float) -> Array:
        """Derivative of the equilibrium just solved for with respect to the parameter (N, 3)."""


@dataclass
class Branch:
    """Equilibria along a leg, in rising order of the parameter.

    Attributes
    ----------
    parameters
        Where equilibria were solved for.
    displacements, slopes
        (N, 3) each: the equilibria [mm] and their derivatives [mm per unit of the parameter].
    iterations
        Newton iterations spent so far.
    """

    parameters: list[float] = field(default_factory=list)
    displacements: list[Array] = field(default_factory=list)
    slopes: list[Array] = field(default_factory=list)
    iterations: int = 0

    def add(self, leg: Leg, start: Array, parameter: float) -> None:
        """Solve for the equilibrium at `parameter` from `start` (N, 3) [mm] and put it in its place."""
        solution = leg.solve(start, parameter)
        slope = leg.slope(solution, parameter)
        place = int(np.searchsorted(self.parameters, parameter))
        self.parameters.insert(place, parameter)
        self.displacements.insert(place, solution.displacement)
        self.slopes.insert(place, slope)
        self.iterations += solution.iterations

    def at(self, parameter: float, nodes: int = NODES) -> Array:
        """Displacement (N, 3) [mm] at `parameter`, by the polynomial through the nearest `nodes` equilibria."""
        place = int(np.searchsorted(self.parameters, parameter))
        first = int(np.clip(place - nodes // 2, 0, max(0, len(self.parameters) - nodes)))
        near = slice(first, first + nodes)
        return hermite(self.parameters[near], self.displacements[near], self.slopes[near], parameter)

    def doubt(self, start: float, stop: float) -> float:
        """Estimated interpolation error between two neighbouring equilibria [mm].

        How far one equilibrium fewer would move the result, in the middle and on both sides of it: at a kink, one place
        alone may agree by chance.
        """
        places = start + np.array([0.2, 0.5, 0.8]) * (stop - start)
        return max(float(np.abs(self.at(x) - self.at(x, NODES - 1)).max()) for x in places)

    def limit(self) -> float | None:
        """Largest parameter of the branch if it turns back just beyond its last equilibrium, else None.

        Near a limit point p* the displacement changes as (p* − p)^½ (E. Riks, Int. J. of Solids and Structures 15,
        1979). So the inverse square of the slope falls to zero along a straight line, here the one through the last two
        equilibria.
        """
        if len(self.parameters) < 2:
            return None
        before, last = (1 / float((slope**2).sum()) for slope in self.slopes[-2:])
        if last >= before:
            return None
        ahead = (self.parameters[-1] - self.parameters[-2]) * last / (before - last)
        return self.parameters[-1] + ahead if ahead <= LIMIT_AHEAD * self.parameters[-1] else None


class NoStart(LabError):
    """No equilibrium was found where a load path begins."""

    def __init__(self) -> None:
        super().__init__(
            "No equilibrium was found at the start of the load path: refine the mesh, or check the material "
            "and the gravity."
        )


class PathEnded(Exception):
    """No equilibrium could be found further on; `branch` holds what was found before."""

    def __init__(self, branch: Branch) -> None:
        super().__init__(f"no equilibrium beyond {branch.parameters[-1]:g}")
        self.branch = branch


def follow(leg: Leg, start: Array, stop: float, first_step: float, report: Callable[[float], None]) -> Branch:
    """Follow the equilibria from parameter 0, where `start` (N, 3) [mm] is one, to `stop`.

    Steps shrink where Newton's method fails and grow where the predictor is good. `report` is told each parameter
    reached.

    Raises
    ------
    PathEnded
        When the step has become too small.
    NoStart
        When there is no equilibrium at parameter 0 near `start`.
    """
    branch, step, nodes = Branch(), first_step, NODES
    try:
        branch.add(leg, start, 0.0)
    except NoConvergence:
        raise NoStart from None
    while branch.parameters[-1] < stop:
        here = branch.parameters[-1]
        remaining = stop - here
        step = min(step, LARGEST_STEP * stop)
        if step > 0.7 * remaining:  # no tiny last step
            step = remaining if step >= remaining else remaining / 2
        target = stop if step == remaining else here + step
        guesses = [branch.at(target, known) for known in range(1, min(NODES, len(branch.parameters)) + 1)]
        try:
            branch.add(leg, guesses[min(nodes, len(guesses)) - 1], target)
        except NoConvergence:
            step /= 4
            if step < SMALLEST_STEP * stop:
                raise PathEnded(branch) from None
            continue
        errors = [float(np.abs(branch.displacements[-1] - guess).max()) for guess in guesses]
        best = 1 + int(np.argmin(errors))
        nodes = NODES if best == len(guesses) else best  # few after a kink
        step *= float(np.clip((PREDICTOR_ERROR_MM / max(min(errors), 1e-12)) ** (1 / (2 * best)), 0.3, GROWTH))
        report(target)
    return branch


def refine(leg: Leg, branch: Branch, wanted: Array, tolerance_mm: float) -> float:
    """Add equilibria at `wanted` parameters (P,) until interpolation there is within `tolerance_mm` [mm].

    Returns the largest estimated error left [mm]. Where the branch is smooth few are added, across a kink in the end
    all that are wanted. One that Newton's method does not find is left out, and the estimate for it counts.
    """
    worst, least = 0.0, SMALLEST_INTERVAL * branch.parameters[-1]
    intervals = list(zip(branch.parameters[:-1], branch.parameters[1:], strict=True))
    while intervals:
        start, stop = intervals.pop()
        inside = wanted[(wanted > start + least) & (wanted < stop - least)]
        if not inside.size:
            continue
        middle, error = float(inside[len(inside) // 2]), branch.doubt(start, stop)
        # Across a kink, few equilibria serve better.
        if error > tolerance_mm and any(added(leg, branch, middle, nodes) for nodes in (NODES, 2)):
            intervals += [(start, middle), (middle, stop)]
        else:
            worst = max(worst, error)
    return worst


def added(leg: Leg, branch: Branch, parameter: float, nodes: int) -> bool:
    """Whether an equilibrium was found at `parameter` from the polynomial through `nodes` equilibria, and added."""
    try:
        branch.add(leg, branch.at(parameter, nodes), parameter)
    except NoConvergence:
        return False
    return True
