"""The load path: equilibria followed with adaptive steps, and known between them by controlled interpolation.

An ODE solver with dense output has the same parts: a predictor of high order, steps sized by its error, and an
interpolant that is part of the solution. Here the predictor is corrected to the equilibrium by Newton's method, so
errors do not add up along the path.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import KroghInterpolator

from pgdl_lab.core.errors import LabError
from pgdl_lab.mechanics.newton import NoConvergence, Solution

Array = NDArray[np.float64]

NODES = 4  # equilibria that predictor and interpolant use: polynomials of degree 7
PREDICTOR_ERROR_MM = 0.3  # what Newton's method mends in some three iterations
SMALLEST_STEP = 1e-5  # as a fraction of the path
SMALLEST_INTERVAL = 1e-4  # of the path: what is nearer to an equilibrium needs none of its own
PLACES = np.array([0.2, 0.5, 0.8])  # of an interval, where its error is estimated: at a kink one may be right by chance
# How much of a change counts as error, where one equilibrium is left out: an end of the interval, or another one.
END_SHARE, OTHER_SHARE = 0.5, 3.0
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
        (found,) = self._through(self.near(parameter, nodes), np.array([parameter]))
        return found

    def near(self, parameter: float, nodes: int = NODES) -> range:
        """Numbers of the `nodes` equilibria that are nearest to `parameter`, or of all there are."""
        place, known = int(np.searchsorted(self.parameters, parameter)), len(self.parameters)
        first = int(np.clip(place - nodes // 2, 0, max(0, known - nodes)))
        return range(first, min(first + nodes, known))

    def doubt(self, start: float, stop: float) -> float:
        """Estimated interpolation error between two neighbouring equilibria [mm].

        The most that the result moves when one of the equilibria that it is made from is left out. A kink beyond that
        one is then out of sight, so what it spoils shows in full. A kink between the two ends spoils what is made with
        all the others by as much at times, but not what is made without an end. Where the branch is smooth that moves
        the result some ten times as much, so it counts less. One kink, of any order up to 3 and anywhere, is never off
        by more than 2.5 times the estimate, as long as neighbouring intervals differ by factors up to 8.
        """
        near, places, doubt = self.near((start + stop) / 2), start + PLACES * (stop - start), 0.0
        result = self._through(near, places)
        for left_out in near:
            share = END_SHARE if start <= self.parameters[left_out] <= stop else OTHER_SHARE
            fewer = self._through([k for k in near if k != left_out], places)
            for before, after in zip(result, fewer, strict=True):
                doubt = max(doubt, share * float(np.abs(after - before).max()))
        return doubt

    def _through(self, numbers: Sequence[int], places: Array) -> list[Array]:
        """Displacements (N, 3) [mm] at `places`, by the polynomial through the equilibria with these `numbers`."""
        nodes = np.repeat([self.parameters[k] for k in numbers], 2)  # twice each: displacement and slope
        known = [each for k in numbers for each in (self.displacements[k], self.slopes[k])]
        weights = KroghInterpolator(nodes, np.eye(len(nodes)))(places)
        return [
            sum((w * each for w, each in zip(row[1:], known[1:], strict=True)), start=row[0] * known[0])
            for row in weights
        ]

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

    Returns the largest estimated error left [mm]. The interval in most doubt gets an equilibrium, which changes what
    its neighbours are interpolated from, so they are asked again; and so on. Where the branch is smooth few are added,
    across a kink in the end all that are wanted. One that Newton's method does not find is left out, and the estimate
    for it counts.
    """
    known: dict[tuple[float, ...], float] = {}
    lost: list[float] = []
    while True:
        doubts = list(_doubts(branch, wanted, known))
        doubtful = [pair for pair in doubts if pair[0] > tolerance_mm and np.isfinite(pair[1]) and pair[1] not in lost]
        if not doubtful:
            return max((doubt for doubt, _ in doubts), default=0.0)
        _, middle = max(doubtful)
        # Across a kink, few equilibria serve better.
        if not any(added(leg, branch, middle, nodes) for nodes in (NODES, 2)):
            lost.append(middle)


def _doubts(branch: Branch, wanted: Array, known: dict[tuple[float, ...], float]) -> Iterator[tuple[float, float]]:
    """The doubt [mm] of each interval in which displacements are `wanted` (P,), and where one more solve serves best.

    That is not a number where all that is wanted lies too close to an equilibrium. Doubts are kept in `known`, by the
    parameters that they follow from.
    """
    least = SMALLEST_INTERVAL * branch.parameters[-1]
    for start, stop in pairwise(branch.parameters):
        between = wanted[(wanted > start) & (wanted < stop)]
        if not between.size:
            continue
        follows_from = (start, *(branch.parameters[k] for k in branch.near((start + stop) / 2)))
        if follows_from not in known:
            known[follows_from] = branch.doubt(start, stop)
        inside = between[(between > start + least) & (between < stop - least)]
        if inside.size:
            yield known[follows_from], float(inside[len(inside) // 2])
        else:  # the error rises from either end with the square of the way
            way = (between - start) / (stop - start)
            yield known[follows_from] * float((16 * (way * (1 - way)) ** 2).max()), np.nan


def added(leg: Leg, branch: Branch, parameter: float, nodes: int) -> bool:
    """Whether an equilibrium was found at `parameter` from the polynomial through `nodes` equilibria, and added."""
    try:
        branch.add(leg, branch.at(parameter, nodes), parameter)
    except NoConvergence:
        return False
    return True
