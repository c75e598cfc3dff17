"""How far a body leans over where its half gives way to motions that break the symmetry.

That an equilibrium gives way is a matter of signs: walls that touch slip past each other by some hundredths of a
millimetre, a slender finger falls over, and both have one negative eigenvalue. So the whole body is pushed along the
mode that gives way, and let go down to a minimum of its energy, by Newton's method with a stiffness that is made
positive definite (K. Levenberg, Quarterly of Applied Mathematics 2, 1944).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.linear import SymmetricSolver
from pgdl_lab.mechanics.newton import CLOSE_MM, NoConvergence, step_length
from pgdl_lab.mechanics.term import Amplitudes, Schedule

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MIRRORED = {8: [0, 2, 1, 3, 4, 6, 5, 7], 4: [0, 1, 3, 2]}  # corners of an element and of its mirror image
LITTLE_PERCENT = 3.0  # of the largest displacement: what leans over by less keeps to its plane
PUSH = 0.01  # of the largest displacement: along the mode, to begin with
FAR = 0.1  # of the largest displacement: who leans so far is not followed farther
LONGEST = 0.05  # of the largest displacement: a step of the descent
SETTLED = 1e-3  # of the largest displacement: the last step
STEPS = 40
LAST = 15  # steps: in each of them a mode that nothing holds grows by a third at least
STIFFER = 4.0  # by how much what is added to the stiffness grows and shrinks
LEAST = 1e-7  # of the mean stiffness: what is added first
LEAST_SHARE = 0.1  # of the mean over all nodes
INVERSE_ITERATIONS = 6


@dataclass(frozen=True)
class Lean:
    """How far a body leans over.

    Attributes
    ----------
    kpa
        Pressure [kPa].
    mm
        Largest difference from being its own mirror image, halved [mm].
    percent
        The same, of the largest displacement [%].
    settled
        Whether it leans no farther; else `mm` is the least that it does.
    """

    kpa: float
    mm: float
    percent: float
    settled: bool

    @property
    def counts(self) -> bool:
        """Whether the half is wrong of the whole body."""
        return not self.settled or self.percent > LITTLE_PERCENT

    def told(self, gives_way_kpa: list[float], equilibria: int, finger: Finger) -> str:
        """What to tell of it, where `gives_way_kpa` of so many equilibria give way."""
        least = "" if self.settled else "at least "
        return (
            f"At {gives_way_kpa[0]:.4g} kPa and {len(gives_way_kpa) - 1} other pressures of {equilibria} the finger "
            f"gives way sideways, by {least}{self.mm:.2g} mm at {self.kpa:.4g} kPa, which half a finger cannot show: "
            f"simulate the whole one, {finger.whole()}."
        )


def whole(mesh: "Mesh") -> "Mesh":
    """The half `mesh` y ≥ 0 and its mirror image, joined at the boundary `symmetry`; all other boundaries are kept."""
    in_plane = np.zeros(mesh.p.shape[1], dtype=bool)
    in_plane[np.unique(mesh.facets[:, mesh.boundaries["symmetry"]])] = True
    twin = np.where(in_plane, np.arange(len(in_plane)), len(in_plane) + np.cumsum(~in_plane) - 1)
    points = np.hstack([mesh.p, mesh.p[:, ~in_plane] * [[1], [-1], [1]]])
    joined = type(mesh)(points, np.hstack([mesh.t, twin[mesh.t[MIRRORED[len(mesh.t)]]]]))
    number = {tuple(corners): facet for facet, corners in enumerate(np.sort(joined.facets, axis=0).T.tolist())}
    named = {}
    for name, facets in mesh.boundaries.items():
        if name != "symmetry":
            corners = np.hstack([mesh.facets[:, facets], twin[mesh.facets[:, facets]]])
            named[name] = np.array([number[tuple(each)] for each in np.sort(corners, axis=0).T.tolist()], dtype=int)
    return joined.with_boundaries(named)


class Leaning:
    """Lets a body lean over that is in equilibrium as far as its half can tell.

    Parameters
    ----------
    half, both
        What balances in the half y ≥ 0, and in the whole body on `whole` of its mesh.
    schedule
        Amplitudes of the loads at each pressure [kPa].
    """

    def __init__(self, half: Equilibrium, both: Equilibrium, schedule: Schedule) -> None:
        from scipy.spatial import cKDTree

        self._half, self._both, self._schedule = half, both, schedule
        ours, tree = half.solid.discretisation.positions, cKDTree(both.solid.discretisation.positions)
        self._right, self._left = (tree.query(ours * [1, side, 1])[1] for side in (1, -1))
        self._mass = _share(both) * np.ones(3)

    def lean(self, solver: SymmetricSolver, displacement: Array, kpa: float, largest_mm: float) -> Lean:
        """How far the body leans that the half says is at `displacement` (N, 3) [mm].

        Parameters
        ----------
        largest_mm
            Largest displacement, which steps and tolerances go by [mm].
        """
        amplitudes = self._schedule.at(kpa)
        start = self._joined(displacement, [1, -1, 1])
        push = self._joined(self._mode(solver, displacement, amplitudes), [-1, 1, -1]) * PUSH * largest_mm
        pushed = start + 0.5 * self._both.free_step(start, push) * push
        at, settled = self._descend(solver, pushed, amplitudes, largest_mm)
        lean_mm = self._lean_mm(at)
        return Lean(kpa, lean_mm, 100 * lean_mm / largest_mm, settled)

    def _joined(self, half: Array, image: list[int]) -> Array:
        result = np.empty_like(self._mass)
        result[self._right], result[self._left] = half, half * image
        return result

    def _lean_mm(self, displacement: Array) -> float:
        difference = displacement[self._right] - displacement[self._left] * [1, -1, 1]
        return float(np.linalg.norm(difference, axis=1).max() / 2)

    def _mode(self, solver: SymmetricSolver, displacement: Array, amplitudes: Amplitudes) -> Array:
        """The way (N, 3) in which the half gives way first, of length 1 where it is longest."""
        half, free = self._half, self._half.sideways
        assert free is not None
        mass = np.broadcast_to(_share(half), free.shape)[free]
        _positive(solver, half.sideways_stiffness(displacement, amplitudes), mass, 0.0)
        way = np.random.default_rng(0).normal(size=len(mass))
        for _ in range(INVERSE_ITERATIONS):
            way = solver.solve(mass * way)
            way /= np.abs(way).max()
        result = np.zeros(free.shape)
        result[free] = way
        return result

    def _descend(
        self, solver: SymmetricSolver, at: Array, amplitudes: Amplitudes, largest_mm: float
    ) -> tuple[Array, bool]:
        """A minimum of the energy below `at` (M, 3), and whether it is one; not if it leans too far or is slow."""
        both, free, added, leans_mm = self._both, self._both.free, 0.0, list[float]()
        for _ in range(STEPS):
            if self._lean_mm(at) > FAR * largest_mm:
                return at, False
            here = both.balance(at, amplitudes, stiffness=True)
            assert here.stiffness is not None
            added = _positive(solver, here.stiffness, self._mass[free], added)
            step = np.zeros_like(at)
            step[free] = -solver.solve(here.forces[free])
            longest = float(np.abs(step).max())
            if not added and longest < SETTLED * largest_mm:
                return at, True
            least = LEAST * _mean(here.stiffness, self._mass[free])
            step *= min(1.0, LONGEST * largest_mm / longest)
            reach = both.free_step(at, step)
            try:
                near = not added and longest < CLOSE_MM  # there energies differ by round-off
                at = at + (reach if near else step_length(both, at, step, amplitudes, here, 0.0, reach)) * step
            except NoConvergence:  # a shorter step may
                added = max(STIFFER**2 * added, least)
                continue
            added = added / STIFFER if added > least else 0.0
            leans_mm.append(self._lean_mm(at))
        return at, len(leans_mm) > LAST and float(np.ptp(leans_mm[-LAST:])) < SETTLED * largest_mm


def _share(equilibrium: Equilibrium) -> Array:
    """What part of the body each node stands for (N, 1) [mm³], never next to nothing.

    The shape functions of corners of elements without a centre have a negative integral.
    """
    volumes = np.abs(equilibrium.solid.discretisation.nodal_volumes())
    return np.asarray(np.maximum(volumes, LEAST_SHARE * volumes.mean())[:, None])


def _positive(solver: SymmetricSolver, upper: sp.csr_matrix, mass: Array, added: float) -> float:
    """Factorise `upper` plus so many times the diagonal `mass` that it is positive definite; from `added` on."""
    while True:
        solver.factorise((upper + sp.diags(added * mass, format="csr")).tocsr())
        if not solver.negative:
            return added
        added = max(STIFFER * added, LEAST * _mean(upper, mass))


def _mean(upper: sp.csr_matrix, mass: Array) -> float:
    return float(upper.diagonal().mean() / mass.mean())
