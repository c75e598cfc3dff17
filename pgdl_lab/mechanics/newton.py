"""Newton's method for an equilibrium, with a line search on the potential energy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.equilibrium import Balance, Equilibrium
from pgdl_lab.mechanics.linear import SymmetricSolver
from pgdl_lab.mechanics.solid import InvertedElement
from pgdl_lab.mechanics.term import Amplitudes

Array = NDArray[np.float64]

MOST_ITERATIONS = 15
SMALLEST_STEP = 1e-3
CLOSE_MM = 1e-2  # corrections below this lie in the basin of quadratic convergence, where energies differ by round-off


class NoConvergence(Exception):
    """Newton's method did not find an equilibrium from where it started."""


@dataclass(frozen=True)
class Solution:
    """An equilibrium.

    Attributes
    ----------
    displacement
        (N, 3) [mm].
    iterations
        How many it took.
    correction_mm
        The last correction [mm]: how far from the equilibrium the stiffness was factorised last.
    """

    displacement: Array
    iterations: int
    correction_mm: float


def solve(
    equilibrium: Equilibrium, solver: SymmetricSolver, start: Array, amplitudes: Amplitudes, tolerance_mm: float
) -> Solution:
    """Find the equilibrium under loads of these `amplitudes`, starting from the displacement `start` (N, 3) [mm].

    Converged when the largest correction is below `tolerance_mm` [mm] and taken whole; the error left is then of the
    order of its square. The first step is taken whole: after a large rotation the energy first rises, because the
    linearised step stretches the body, and the second step takes that back. Every later step must lower the energy
    (Armijo).

    Raises
    ------
    NoConvergence
        After too many iterations, or when no step lowers the energy.
    """
    displacement, free = start, equilibrium.free
    for iteration in range(1, MOST_ITERATIONS + 1):
        try:
            here = equilibrium.balance(displacement, amplitudes, stiffness=True)
        except InvertedElement as error:
            raise NoConvergence from error
        solver.factorise(here.stiffness)
        correction = np.zeros_like(start)
        correction[free] = -solver.solve(here.forces[free])
        largest = float(np.abs(correction).max())
        if not np.isfinite(largest):
            raise NoConvergence
        reach = equilibrium.free_step(displacement, correction)
        step = 1.0
        if largest > CLOSE_MM or reach < 1:
            descent = np.inf if iteration == 1 and reach == 1 else float((here.forces * correction)[free].sum())
            step = step_length(equilibrium, displacement, correction, amplitudes, here, descent, reach)
        displacement = displacement + step * correction
        if largest < tolerance_mm and step == 1:
            return Solution(displacement, iteration, largest)
    raise NoConvergence


def step_length(
    equilibrium: Equilibrium,
    displacement: Array,
    correction: Array,
    amplitudes: Amplitudes,
    here: Balance,
    descent: float,
    longest: float,
) -> float:
    """Largest of 1, ½, ¼, … times `longest` that keeps all elements valid and lowers the energy.

    The energy must fall in proportion to `descent` [N mm]; an infinite `descent` accepts any energy.

    Raises
    ------
    NoConvergence
        When no step down to `SMALLEST_STEP` does.
    """
    step = longest
    while step >= SMALLEST_STEP:
        try:
            there = equilibrium.balance(displacement + step * correction, amplitudes, stiffness=False)
        except InvertedElement:
            step /= 2
            continue
        if there.energy <= here.energy + 1e-4 * step * descent:
            return step
        step /= 2
    raise NoConvergence
