"""From rest to the highest pressure: the equilibria of a body as its loads are put on and its pressure rises."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import DISPLACEMENT, TANGENT
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import LabError
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.linear import SymmetricSolver, symmetric_solver
from pgdl_lab.mechanics.newton import NoConvergence, Solution, solve
from pgdl_lab.mechanics.path import SMALLEST_STEP, Branch, PathEnded, follow, refine
from pgdl_lab.mechanics.term import Amplitudes, Schedule

Array = NDArray[np.float64]

FIRST_WEIGHT = 0.1  # of the weight
FIRST_PRESSURE = 0.04  # of the highest pressure
SAME_STIFFNESS_MM = 1e-8  # a displacement so small leaves slopes as they are, even for interpolation to 1e-5 mm


def unborne(branch: Branch, loads: Amplitudes) -> str:
    """Why a path ended before all of `loads` were on: at a limit point, or where Newton's method found no more."""
    reached, units = f"{branch.parameters[-1]:.2%}", "finger.density_kg_m3 and finger.gravity_m_s2"
    what = "weight" if [*loads] == ["weight"] else f"loads ({', '.join(loads)})"
    if branch.limit() is not None:
        return f"The finger bears only {reached} of its {what}: check the units of {units}, or make it stiffer."
    return (
        f"Newton's method found no equilibrium beyond {reached} of the finger's {what}, however small the step (down "
        f"to {SMALLEST_STEP:.3%}): it may bear no more, so check the units of {units}; if they are right, refine the "
        "mesh."
    )


class SlippedThrough(Exception):
    """Contact follows curved faces so coarsely that they pass through each other, and can follow them more finely."""


@dataclass
class LoadLeg:
    """A leg of the load path: the equilibria as loads follow a schedule.

    Attributes
    ----------
    equilibrium
        What balances.
    solver
        Factorises its stiffness.
    tolerance_mm
        Of each equilibrium [mm].
    schedule
        Amplitudes of the loads at a value of the parameter.
    unstable
        Values of the parameter at which the equilibrium found is not a minimum of the energy.
    watch
        Factorises the stiffness against motions that break the symmetry; None: they are not looked at.
    sideways
        Values of the parameter at which the equilibrium gives way to such motions.
    """

    equilibrium: Equilibrium
    solver: SymmetricSolver
    tolerance_mm: float
    schedule: Schedule
    watch: SymmetricSolver | None = None
    unstable: list[float] = field(default_factory=list)
    sideways: list[float] = field(default_factory=list)
    _found: dict[float, Array] = field(default_factory=dict)
    _slopes: dict[float, Array] = field(default_factory=dict)

    def solve(self, start: Array, parameter: float) -> Solution:
        """As `newton.solve`; contact that waits is brought in by the first solution that it concerns."""
        contact = self.equilibrium.contact
        nearest = min(self._found, key=lambda known: abs(known - parameter), default=parameter)
        before = self._found.get(nearest, start)
        if self.equilibrium.free_step(before, start - before) < 1:  # beyond a surface: the tangent may not be
            start = before + (parameter - nearest) * self._slopes[nearest]
            if self.equilibrium.free_step(before, start - before) < 1:
                raise NoConvergence
        solution = solve(self.equilibrium, self.solver, start, self.schedule.at(parameter), self.tolerance_mm)
        found = solution.displacement
        if contact is not None:
            if contact.mode == "auto" and not contact.active and (contact.near(found) or contact.passes(before, found)):
                contact.active = True
                raise NoConvergence  # so that the step is taken again, shorter
            if contact.active and contact.slips_through(found) and contact.follow_more_finely():
                raise SlippedThrough
        self._found[parameter] = found
        return solution

    def drive(self, displacement: Array, parameter: float) -> Array:
        """Derivative of the nodal forces (N, 3) of the loads with respect to the parameter, at a displacement [mm]."""
        return self.equilibrium.drive(displacement, self.schedule.rates(parameter))

    def slope(self, solution: Solution, parameter: float) -> Array:
        free, displacement = self.equilibrium.free, solution.displacement
        amplitudes = self.schedule.at(parameter)
        if solution.correction_mm > SAME_STIFFNESS_MM:
            balance = self.equilibrium.balance(displacement, amplitudes, stiffness=True)
            self.solver.factorise(balance.stiffness)
        if self.solver.negative:
            self.unstable.append(parameter)
        slope = np.zeros_like(displacement)
        slope[free] = self.solver.solve(self.drive(displacement, parameter)[free])
        self._slopes[parameter] = slope
        if self.watch is not None:
            self.solver.release()  # the factors of one matrix at a time
            self.watch.factorise(self.equilibrium.sideways_stiffness(displacement, amplitudes))
            self.watch.release()
            if self.watch.negative:
                self.sideways.append(parameter)
        return slope


@dataclass(frozen=True)
class History:
    """The equilibria of a finger under its weight and rising pressure.

    Attributes
    ----------
    branch
        The leg of rising pressure, parametrised in kPa.
    complete
        Whether it reaches the highest pressure.
    interpolation_mm
        Largest estimated error between the equilibria [mm].
    iterations
        Newton iterations in all, those for the weight included.
    unstable_kpa
        Pressures [kPa] at which the equilibrium is not a minimum of the energy.
    sideways_unstable_kpa
        Those [kPa] at which it is none of the whole body's, though it may be one of the half that is meshed: it gives
        way to motions that break the symmetry.
    """

    branch: Branch
    complete: bool
    interpolation_mm: float
    iterations: int
    unstable_kpa: list[float]
    sideways_unstable_kpa: list[float]

    @property
    def reached_kpa(self) -> float:
        """Highest pressure with an equilibrium [kPa]."""
        return self.branch.parameters[-1]

    @property
    def limit_kpa(self) -> float | None:
        """Where the pressure has a maximum that ends the branch [kPa]; None if it ends otherwise."""
        return None if self.complete else self.branch.limit()

    def provenance(self) -> dict[str, Any]:
        """What is to be known of it."""
        return {
            "equilibria_kpa": self.branch.parameters,
            "newton_iterations": self.iterations,
            "interpolation_error_mm": self.interpolation_mm,
            "unstable_kpa": self.unstable_kpa,
            "limit_kpa": self.limit_kpa,
        }

    def warnings(self) -> list[str]:
        """What to tell of equilibria that are no minimum, in sentences."""
        unstable = self.unstable_kpa
        return [f"The equilibria at {unstable} kPa are unstable: the finger would snap through."] if unstable else []

    def trouble(self, finger: Finger, count: int, asked: int, remedy: str) -> str:
        """Why the path ended, `count` of whose `asked` snapshots converged, and what to do; empty if it is complete."""
        if self.complete:
            return ""
        limit = self.limit_kpa
        why = "" if limit is None else f" The pressure has a maximum near {limit:.4g} kPa: there it balloons or snaps."
        return (
            f"The finger was in equilibrium up to {self.reached_kpa:.4g} kPa, but not at "
            f"finger.max_kpa={finger.max_kpa:g}: {count} of {asked} snapshots converged.{why} Lower the pressure, "
            f"{remedy}."
        )

    def reached(self, pressures_kpa: Array) -> Array:
        """Those of `pressures_kpa` (P,) [kPa] that the branch reaches."""
        return pressures_kpa[pressures_kpa <= self.reached_kpa * (1 + 1e-12)]

    def at(self, kpa: float) -> Array:
        """Displacement (N, 3) [mm] of all nodes at a pressure [kPa]."""
        return self.branch.at(kpa)

    def body(self, domain: Domain) -> Dataset:
        """The equilibria and their tangents on the whole body."""
        fields = {DISPLACEMENT: np.array(self.branch.displacements), TANGENT: np.array(self.branch.slopes)}
        return replace(Dataset.path(domain, np.array(self.branch.parameters), fields[DISPLACEMENT]), fields=fields)


def load(
    equilibrium: Equilibrium,
    solver: SymmetricSolver,
    schedules: tuple[Schedule, Schedule],
    pressures_kpa: Array,
    newton_mm: float,
    interpolation_mm: float,
) -> History:
    """Put on what acts besides the pressure, then raise the pressure.

    Parameters
    ----------
    schedules
        Amplitudes as the loads are put on, by a parameter from 0 to 1, and at each pressure [kPa].
    pressures_kpa
        (P,) rising: where the displacement will be asked for, the highest last [kPa].
    newton_mm
        Tolerance of each equilibrium [mm].
    interpolation_mm
        Tolerance at `pressures_kpa` between the equilibria [mm].

    Raises
    ------
    LabError
        When the body does not bear its own weight.
    """
    max_kpa, watch = float(pressures_kpa[-1]), None if equilibrium.sideways is None else symmetric_solver()
    settle = LoadLeg(equilibrium, solver, newton_mm, schedules[0])
    inflate = LoadLeg(equilibrium, solver, newton_mm, schedules[1], watch)
    try:
        with closing(solver), closing(watch) if watch else nullcontext(), progress() as show:
            resting, settling = np.zeros(equilibrium.free.shape), 0
            if settle.drive(resting, 0.0).any():
                try:
                    settled = follow(settle, resting, 1.0, FIRST_WEIGHT, lambda w: show(0.0, f"{w:4.0%} of the weight"))
                except PathEnded as end:
                    raise LabError(unborne(end.branch, schedules[0].at(1.0))) from None
                resting, settling = settled.displacements[-1], settled.iterations
            complete, report = True, lambda kpa: show(kpa / max_kpa, f"{kpa:5.1f} of {max_kpa:g} kPa")
            try:
                branch = follow(inflate, resting, max_kpa, FIRST_PRESSURE * max_kpa, report)
            except PathEnded as end:
                branch, complete = end.branch, False
            error = refine(inflate, branch, pressures_kpa, interpolation_mm)
    except SlippedThrough:  # what was found before is no equilibrium of the finer contact
        return load(equilibrium, solver, schedules, pressures_kpa, newton_mm, interpolation_mm)
    iterations = settling + branch.iterations
    return History(branch, complete, error, iterations, sorted(inflate.unstable), sorted(inflate.sideways))


@contextmanager
def progress() -> Iterator[Callable[[float, str], None]]:
    """A progress bar; the function it yields takes the fraction done and what to say."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("Simulating"), BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("meshed", total=1.0)
        yield lambda done, text: progress.update(task, completed=done, description=text)
