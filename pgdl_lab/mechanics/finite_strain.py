"""A finger as a three-dimensional finite-strain solid: from mesh to the history of its equilibria."""

from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.contact import REACH_MM, Contact
from pgdl_lab.mechanics.discretisation_error import DiscretisationError, estimate, refined
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, choose, discretise
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.leaning import Lean, Leaning, whole
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.loading import History, load, progress
from pgdl_lab.mechanics.memory import require
from pgdl_lab.mechanics.places import interpolation_at
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.mechanics.term import Amplitudes, Term
from pgdl_lab.mechanics.vtk import vtk_cells

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]

PROBED = 200  # points at a time


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
        acting = self.equilibrium.contact
        assert acting is not None
        self.contact = acting
        self.solver = symmetric_solver()

    def equilibrium_on(
        self, mesh: "Mesh", contact: Callable[[Discretisation], Contact | None] = lambda _: None
    ) -> Equilibrium:
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
        terms: dict[str, Term] = {"solid": Solid(discretisation, self.finger.material)}
        terms |= self.finger.loads(discretisation)
        if (made := contact(discretisation)) is not None:
            terms["contact"] = made
        return Equilibrium(terms, free, sideways)

    def _contact(self, discretisation: Discretisation, mode: str) -> Contact:
        return Contact(discretisation, self.contact_mm, self.finger.material.shear_modulus_mpa / 40, mode=mode)

    def load(self, pressures_kpa: Array, newton_mm: float, interpolation_mm: float) -> History:
        """Put on the finger's loads, then raise the pressure; see `loading.load`."""
        return load(self.equilibrium, self.solver, self.finger.schedules(), pressures_kpa, newton_mm, interpolation_mm)

    def amplitudes(self, kpa: float) -> Amplitudes:
        """Of all loads at a pressure [kPa]."""
        return self.finger.schedules()[1].at(kpa)

    def reaction_and_load_n(self, displacement: Array, kpa: float) -> tuple[Array, Array]:
        """Reaction of the support, and sum of all loads: (3,) each [N], for what is meshed.

        They cancel; the other half of a finger, where only one is meshed, counts as support along y.
        """
        return self.equilibrium.reaction_and_load(displacement, self.amplitudes(kpa))

    def volumes_mm3(self, displacement: Array) -> dict[str, float]:
        """Enclosed volume of each chamber [mm³] at `displacement` (N, 3) [mm], for what is meshed."""
        return self.equilibrium.volumes_mm3(displacement)

    def discretisation_error(self, history: History) -> DiscretisationError | None:
        """Estimated for the equilibrium at the highest pressure; None if none can be had."""
        highest, contact = history.branch.displacements[-1], self.contact
        touching = contact.active and contact.near(highest)
        with progress() as show:
            show(0.0, "discretisation error")
            # It acts at the places where it acted, which are then where they were: none crosses another.
            fine = self.equilibrium_on(
                refined(self.mesh),
                lambda on: contact.carried(lambda places: interpolation_at(on, places)) if touching else None,
            )
            return estimate(self.equilibrium, fine, highest, history.reached_kpa, self.amplitudes(history.reached_kpa))

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
        contact, farthest = self.contact, Lean(gives_way_kpa[-1], 0.0, 0.0, True)
        with closing(symmetric_solver()) as solver, progress() as show:
            show(0.0, "leaning over")
            both = self.equilibrium_on(
                whole(self.mesh), lambda on: self._contact(on, "on").like(contact) if contact.active else None
            )
            leaning = Leaning(self.equilibrium, both, self.finger.schedules()[1])
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
                solver.factorise(self.equilibrium.sideways_stiffness(displacement, self.amplitudes(kpa)))
                if solver.negative:
                    found.append(kpa)
        return found

    def crossed_kpa(self, parameters: list[float], displacements: list[Array]) -> list[float]:
        """Pressures [kPa] at which surfaces pass through each other at these displacements (N, 3) [mm]."""
        states = zip(parameters, displacements, strict=True)
        return [kpa for kpa, displacement in states if self.contact.penetrates(displacement)]

    def contact_report(self, history: History) -> dict[str, Any]:
        """Whether contact acted, the smallest gap [mm] (None: none near) and the pressures [kPa] with penetration."""
        contact, branch = self.contact, history.branch
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
