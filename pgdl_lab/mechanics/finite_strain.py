"""A finger as a three-dimensional finite-strain solid: from mesh to the history of its equilibria."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import DISPLACEMENT, TANGENT
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.contact import REACH_MM, Contact, NoContact
from pgdl_lab.mechanics.discretisation_error import DiscretisationError, estimate, refined
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, choose, discretise
from pgdl_lab.mechanics.equilibrium import Equilibrium, Load
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.leaning import Lean, Leaning, whole
from pgdl_lab.mechanics.linear import SymmetricSolver, symmetric_solver
from pgdl_lab.mechanics.memory import require
from pgdl_lab.mechanics.newton import NoConvergence, Solution, solve
from pgdl_lab.mechanics.path import SMALLEST_STEP, Branch, PathEnded, follow, refine
from pgdl_lab.mechanics.places import interpolation_at
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.mechanics.vtk import vtk_cells

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]

FIRST_WEIGHT = 0.1  # of the weight
FIRST_PRESSURE = 0.04  # of the highest pressure
SAME_STIFFNESS_MM = 1e-8  # a displacement so small leaves slopes as they are, even for interpolation to 1e-5 mm
PROBED = 200  # points at a time


def unborne(branch: Branch) -> str:
    """Why a path ended before the whole weight was on: at a limit point, or where Newton's method found no more."""
    reached, units = f"{branch.parameters[-1]:.2%}", "finger.density_kg_m3 and finger.gravity_m_s2"
    if branch.limit() is not None:
        return f"The finger bears only {reached} of its weight: check the units of {units}, or make it stiffer."
    return (
        f"Newton's method found no equilibrium beyond {reached} of the finger's weight, however small the step (down "
        f"to {SMALLEST_STEP:.3%}): it may bear no more, so check the units of {units}; if they are right, refine the "
        "mesh."
    )


class SlippedThrough(Exception):
    """Contact follows curved faces so coarsely that they pass through each other, and can follow them more finely."""


@dataclass
class LoadLeg:
    """A leg of the load path: the equilibria as one load rises.

    Attributes
    ----------
    load
        What acts at a value of the parameter.
    driver
        Derivative of the outer nodal forces with respect to the parameter (N, 3), at a displacement (N, 3) [mm].
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
    load: Callable[[float], Load]
    driver: Callable[[Array], Array]
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
        if contact.active and contact.free_step(before, start - before) < 1:  # beyond a surface: the tangent may not be
            start = before + (parameter - nearest) * self._slopes[nearest]
            if contact.free_step(before, start - before) < 1:
                raise NoConvergence
        solution = solve(self.equilibrium, self.solver, start, self.load(parameter), self.tolerance_mm)
        found = solution.displacement
        if contact.mode == "auto" and not contact.active and (contact.near(found) or contact.passes(before, found)):
            contact.active = True
            raise NoConvergence  # so that the step is taken again, shorter
        if contact.active and contact.slips_through(found) and contact.follow_more_finely():
            raise SlippedThrough
        self._found[parameter] = found
        return solution

    def slope(self, solution: Solution, parameter: float) -> Array:
        free, displacement = self.equilibrium.free, solution.displacement
        if solution.correction_mm > SAME_STIFFNESS_MM:
            balance = self.equilibrium.balance(displacement, self.load(parameter), stiffness=True)
            self.solver.factorise(balance.stiffness)
        if self.solver.negative:
            self.unstable.append(parameter)
        slope = np.zeros_like(displacement)
        slope[free] = self.solver.solve(self.driver(displacement)[free])
        self._slopes[parameter] = slope
        if self.watch is not None:
            self.solver.release()  # the factors of one matrix at a time
            self.watch.factorise(self.equilibrium.sideways_stiffness(displacement, self.load(parameter)))
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

    def ending(self, finger: Finger, count: int, asked: int) -> str:
        """What to tell of a branch that is not complete, `count` of whose `asked` snapshots converged."""
        limit = self.limit_kpa
        why = "" if limit is None else f" The pressure has a maximum near {limit:.4g} kPa: there it balloons or snaps."
        return (
            f"The finger was in equilibrium up to {self.reached_kpa:.4g} kPa, but not at "
            f"finger.max_kpa={finger.max_kpa:g}: {count} of {asked} snapshots converged.{why}"
        )

    def at(self, kpa: float) -> Array:
        """Displacement (N, 3) [mm] of all nodes at a pressure [kPa]."""
        return self.branch.at(kpa)

    def body(self, domain: Domain) -> Dataset:
        """The equilibria and their tangents on the whole body."""
        fields = {DISPLACEMENT: np.array(self.branch.displacements), TANGENT: np.array(self.branch.slopes)}
        return replace(Dataset.path(domain, np.array(self.branch.parameters), fields[DISPLACEMENT]), fields=fields)


class Model:
    """The half finger, meshed and held at the clamp and in the plane of symmetry; or the whole finger.

    Parameters
    ----------
    finger
        What is modelled.
    edge_mm
        Longest element edge [mm].
    element
        One of `pgdl_lab.mechanics.elements.ELEMENTS`, or "auto".
    contact
        "auto" (from the step in which surfaces first touch), "on" (from the start) or "off".
    contact_mm
        Distance below which surfaces push each other apart [mm].

    Raises
    ------
    TooLarge
        When there is not enough memory for the mesh.
    """

    def __init__(
        self, finger: Finger, edge_mm: float, element: str, contact: str = "off", contact_mm: float = REACH_MM
    ) -> None:
        self.finger = finger
        self.mesh = finger.mesh(edge_mm)
        self.element = choose(element, self.mesh)
        require(self.mesh, ELEMENTS[self.element], edge_mm, finger.mesh, refined=False)
        self.contact_mm = contact_mm
        self.equilibrium = self.equilibrium_on(self.mesh, lambda on: self._contact(on, contact))
        self.discretisation = self.equilibrium.solid.discretisation
        self.solver = symmetric_solver()

    def equilibrium_on(self, mesh: "Mesh", contact: Callable[[Discretisation], Contact]) -> Equilibrium:
        """What balances in the finger on `mesh` [mm], with the contact made for it.

        Raises
        ------
        InputError
            When `mesh` is that of half a finger and gravity breaks its symmetry.
        """
        discretisation = discretise(mesh, ELEMENTS[self.element])
        basis = discretisation.basis
        free = np.ones(discretisation.positions.shape, dtype=bool)
        free[basis.get_dofs("clamp").all()] = False
        sideways = None
        if "symmetry" in mesh.boundaries:
            if not self.finger.planar:
                raise InputError(
                    f"finger.gravity_m_s2 is {list(self.finger.gravity_m_s2)}, and half a finger cannot be pulled "
                    "along y: mesh the whole finger, without a group of symmetry, or leave out the part along y."
                )
            plane, sideways = basis.get_dofs("symmetry").all(), free.copy()
            free[plane, 1] = False
            sideways[plane, 0] = sideways[plane, 2] = False
        return Equilibrium(
            Solid(discretisation, self.finger.material),
            Cavity(basis),
            self.finger.body_force_n_mm3,
            free,
            contact(discretisation),
            sideways,
        )

    def _contact(self, discretisation: Discretisation, mode: str) -> Contact:
        return Contact(discretisation, self.contact_mm, self.finger.material.shear_modulus_mpa / 40, mode=mode)

    def load(self, pressures_kpa: Array, newton_mm: float, interpolation_mm: float) -> History:
        """Apply the weight, then the pressure.

        Parameters
        ----------
        pressures_kpa
            (P,) rising: where the displacement will be asked for, the highest last [kPa].
        newton_mm
            Tolerance of each equilibrium [mm].
        interpolation_mm
            Tolerance at `pressures_kpa` between the equilibria [mm].

        Raises
        ------
        LabError
            When the finger does not bear its own weight.
        """
        while True:
            try:
                return self._loaded(pressures_kpa, newton_mm, interpolation_mm)
            except SlippedThrough:  # what was found before is no equilibrium of the finer contact
                continue

    def _loaded(self, pressures_kpa: Array, newton_mm: float, interpolation_mm: float) -> History:
        equilibrium, max_kpa = self.equilibrium, float(pressures_kpa[-1])
        weigh = LoadLeg(equilibrium, self.solver, newton_mm, lambda w: Load(w, 0.0), lambda _: equilibrium.weight)
        inflate = LoadLeg(
            equilibrium,
            self.solver,
            newton_mm,
            lambda kpa: Load(1.0, 1e-3 * kpa),
            lambda displacement: 1e-3 * equilibrium.pressure_forces(displacement),
            watch=None if equilibrium.sideways is None else symmetric_solver(),
        )
        watching = closing(inflate.watch) if inflate.watch else nullcontext()
        with closing(self.solver), watching, progress() as show:
            resting, weighing = np.zeros_like(equilibrium.weight), 0
            if equilibrium.weight.any():
                try:
                    settled = follow(weigh, resting, 1.0, FIRST_WEIGHT, lambda w: show(0.0, f"{w:4.0%} of the weight"))
                except PathEnded as end:
                    raise LabError(unborne(end.branch)) from None
                resting, weighing = settled.displacements[-1], settled.iterations
            complete, report = True, lambda kpa: show(kpa / max_kpa, f"{kpa:5.1f} of {max_kpa:g} kPa")
            try:
                branch = follow(inflate, resting, max_kpa, FIRST_PRESSURE * max_kpa, report)
            except PathEnded as end:
                branch, complete = end.branch, False
            error = refine(inflate, branch, pressures_kpa, interpolation_mm)
        iterations = weighing + branch.iterations
        return History(branch, complete, error, iterations, sorted(inflate.unstable), sorted(inflate.sideways))

    def reaction_and_load_n(self, displacement: Array, kpa: float) -> tuple[Array, Array]:
        """Reaction of the support, and sum of weight and pressure: (3,) each [N], for what is meshed.

        They cancel; the other half of a finger, where only one is meshed, counts as support along y.
        """
        return self.equilibrium.reaction_and_load(displacement, Load(1.0, 1e-3 * kpa))

    def discretisation_error(self, history: History) -> DiscretisationError | None:
        """Estimated for the equilibrium at the highest pressure; None if none can be had."""
        highest, contact = history.branch.displacements[-1], self.equilibrium.contact
        touching = contact.active and contact.near(highest)
        with progress() as show:
            show(0.0, "discretisation error")
            # It acts at the places where it acted, which are then where they were: none crosses another.
            fine = self.equilibrium_on(
                refined(self.mesh),
                lambda on: contact.carried(lambda places: interpolation_at(on, places)) if touching else NoContact(),
            )
            return estimate(self.equilibrium, fine, highest, history.reached_kpa)

    def lean(self, parameters: list[float], displacements: list[Array], gives_way_kpa: list[float]) -> Lean | None:
        """How far the body leans over where its half gives way sideways; the farthest, None where it never does.

        Looked at are the highest, the lowest and the middle pressure of `gives_way_kpa`, until it leans far.

        Parameters
        ----------
        parameters, displacements
            Pressures [kPa] and their equilibria (N, 3) [mm].
        """
        if not gives_way_kpa:
            return None
        largest_mm = max(float(np.linalg.norm(each, axis=1).max()) for each in displacements)
        contact, farthest = self.equilibrium.contact, Lean(gives_way_kpa[-1], 0.0, 0.0, True)
        with closing(symmetric_solver()) as solver, progress() as show:
            show(0.0, "leaning over")
            both = self.equilibrium_on(
                whole(self.mesh), lambda on: self._contact(on, "on").like(contact) if contact.active else NoContact()
            )
            leaning = Leaning(self.equilibrium, both)
            for kpa in dict.fromkeys([gives_way_kpa[place] for place in (-1, 0, len(gives_way_kpa) // 2)]):
                found = leaning.lean(solver, displacements[parameters.index(kpa)], kpa, largest_mm)
                farthest = max(farthest, found, key=lambda each: (not each.settled, each.mm))
                if not found.settled:
                    break
        return farthest

    def gives_way_kpa(self, parameters: list[float], displacements: list[Array]) -> list[float]:
        """Pressures [kPa] at which equilibria (N, 3) [mm] that others found give way sideways; none if whole."""
        if self.equilibrium.sideways is None:
            return []
        found = []
        with closing(symmetric_solver()) as solver:
            for kpa, displacement in zip(parameters, displacements, strict=True):
                solver.factorise(self.equilibrium.sideways_stiffness(displacement, Load(1.0, 1e-3 * kpa)))
                if solver.negative:
                    found.append(kpa)
        return found

    def crossed_kpa(self, parameters: list[float], displacements: list[Array]) -> list[float]:
        """Pressures [kPa] at which surfaces pass through each other at these displacements (N, 3) [mm]."""
        states = zip(parameters, displacements, strict=True)
        return [kpa for kpa, displacement in states if self.equilibrium.contact.penetrates(displacement)]

    def contact_report(self, history: History) -> dict[str, Any]:
        """Whether contact acted, the smallest gap [mm] (None: none near) and the pressures [kPa] with penetration."""
        contact, branch = self.equilibrium.contact, history.branch
        smallest = min(contact.gap_mm(displacement) for displacement in branch.displacements)
        return {
            "acted": contact.active and any(contact.near(displacement) for displacement in branch.displacements),
            "smallest_gap_mm": smallest if np.isfinite(smallest) else None,
            "penetration_kpa": self.crossed_kpa(branch.parameters, branch.displacements),
        }

    def probe(self, face: Face) -> Callable[[Array], Array]:
        """Function from a displacement of all nodes (M, 3) to u_x and u_z at the points of `face` (N, 2) [mm]."""
        import scipy.sparse as sp

        x, z = face.domain.points_mm.T
        at = np.vstack([x, np.broadcast_to(face.y_mm, len(x)), z])
        # scikit-fem looks for every point in every element that is near any of them.
        parts = np.array_split(at, range(PROBED, len(x), PROBED), axis=1)
        matrix = sp.vstack([self.discretisation.basis.probes(part) for part in parts], format="csr")
        return lambda displacement: matrix @ displacement[:, [0, 2]]

    def domain(self, face: Face | None = None) -> Domain:
        """The mesh, in the order of VTK; its base line is made of the nodes nearest to that of the observed `face`."""
        name, cells = vtk_cells(self.discretisation)
        clamp, base = np.flatnonzero(~self.equilibrium.free.any(axis=1)), np.empty(0, dtype=np.int64)
        if face is not None:
            from scipy.spatial import cKDTree

            line = np.insert(face.domain.points_mm, 1, face.y_mm, axis=1)[face.domain.base]
            nearest = cKDTree(self.discretisation.positions).query(line)[1]
            base = np.array(list(dict.fromkeys(nearest.tolist())), dtype=np.int64)
        return Domain(self.discretisation.positions, cells, name, base, clamp)


@contextmanager
def progress() -> Iterator[Callable[[float, str], None]]:
    """A progress bar; the function it yields takes the fraction done and what to say."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("Simulating"), BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("meshed", total=1.0)
        yield lambda done, text: progress.update(task, completed=done, description=text)
