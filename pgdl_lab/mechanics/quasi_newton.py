"""An equilibrium by the BFGS method, for meshes on which a factorisation costs as much as dozens of force vectors.

Each direction comes from the stiffness factorised last and from how the forces have changed since (H. Matthies,
G. Strang, Int. J. for Numerical Methods in Engineering 14, 1979; the updates as in J. Nocedal, Mathematics
of Computation 35, 1980). Each step lowers the potential energy (Armijo).
"""

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.equilibrium import Balance, Equilibrium
from pgdl_lab.mechanics.linear import SymmetricSolver
from pgdl_lab.mechanics.newton import NoConvergence
from pgdl_lab.mechanics.solid import InvertedElement
from pgdl_lab.mechanics.term import Amplitudes

Array = NDArray[np.float64]

FIRST_STEPS = 6  # with the stiffness that the caller has factorised, which need not be that of the start
STEPS = 10  # with each stiffness of the energy itself
FACTORISATIONS = 4
SMALLEST_STEP = 1e-4
ROUND_OFF = 1e-13  # of an energy
LITTLE = 1e-10  # of the energy released since the start: a step that promises less leads nowhere


def settle(
    equilibrium: Equilibrium, solver: SymmetricSolver, start: Array, amplitudes: Amplitudes, accuracy: float
) -> Array:
    """The equilibrium (N, 3) [mm] under loads of these `amplitudes` that lies below `start` (N, 3) [mm] in energy.

    Parameters
    ----------
    solver
        Has factorised a positive definite matrix that resembles the stiffness near the start.
    accuracy
        The last step is smaller than this part of the largest way from the start [–].

    Raises
    ------
    NoConvergence
        When the equilibrium is not found with few factorisations.
    """
    try:
        highest = equilibrium.balance(start, amplitudes, stiffness=False).energy
    except InvertedElement as error:
        raise NoConvergence from error
    displacement, near = _descend(equilibrium, solver, start, highest, start, amplitudes, 0.0, FIRST_STEPS)
    if near:
        return displacement
    for _ in range(FACTORISATIONS):
        solver.factorise(equilibrium.balance(displacement, amplitudes, stiffness=True).stiffness)
        displacement, near = _descend(equilibrium, solver, start, highest, displacement, amplitudes, accuracy, STEPS)
        if near:
            return displacement
    raise NoConvergence


def _descend(
    equilibrium: Equilibrium,
    solver: SymmetricSolver,
    start: Array,
    highest: float,
    displacement: Array,
    amplitudes: Amplitudes,
    accuracy: float,
    steps: int,
) -> tuple[Array, bool]:
    """Take at most `steps` from `displacement`; also whether it is near enough. At `start` the energy is `highest`."""
    free, updates = equilibrium.free, list[tuple[Array, Array, float]]()
    here = equilibrium.balance(displacement, amplitudes, stiffness=False)
    for _ in range(steps):
        way = np.zeros_like(start)
        way[free] = -_direction(solver, updates, here.forces[free])
        slope = float((here.forces * way)[free].sum())
        if abs(slope) <= LITTLE * (highest - here.energy):
            return displacement, True
        length, there = _step(equilibrium, displacement, way, amplitudes, here, slope)
        if length == 0:  # another stiffness may know a better way
            break
        step = length * way
        displacement = displacement + step
        moved, change = step[free], (there.forces - here.forces)[free]
        curvature, here = float(moved @ change), there
        if length == 1 and np.abs(step).max() <= accuracy * np.abs(displacement - start).max():
            return displacement, True
        if curvature > 0:
            updates.append((moved, change, 1 / curvature))
    return displacement, False


def _direction(solver: SymmetricSolver, updates: list[tuple[Array, Array, float]], forces: Array) -> Array:
    """The updated inverse of the stiffness times `forces` (n,)."""
    rest, parts = forces.copy(), []
    for moved, change, inverse in reversed(updates):
        parts.append(inverse * float(moved @ rest))
        rest -= parts[-1] * change
    result = solver.solve(rest)
    for (moved, change, inverse), part in zip(updates, reversed(parts), strict=True):
        result += (part - inverse * float(change @ result)) * moved
    return result


def _step(
    equilibrium: Equilibrium, displacement: Array, way: Array, amplitudes: Amplitudes, here: Balance, slope: float
) -> tuple[float, Balance]:
    """How much of `way` (N, 3) lowers the energy enough, and the balance there; 0 if nothing does."""
    length, noise = equilibrium.free_step(displacement, way), ROUND_OFF * abs(here.energy)
    while slope < 0 and length >= SMALLEST_STEP:
        try:
            there = equilibrium.balance(displacement + length * way, amplitudes, stiffness=False)
        except InvertedElement:
            length /= 2
            continue
        excess = there.energy - here.energy - length * slope
        if excess <= -0.9999 * length * slope + noise:
            return length, there
        length *= float(np.clip(-length * slope / (2 * excess), 0.1, 0.5))
    return 0.0, here
