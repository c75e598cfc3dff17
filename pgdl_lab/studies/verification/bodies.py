"""Bodies that are no fingers, for the solver that fingers have: blocks, rings, beams and their loads."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, discretise
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.loading import LoadLeg
from pgdl_lab.mechanics.material import Material
from pgdl_lab.mechanics.newton import solve
from pgdl_lab.mechanics.path import Branch, follow
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.mechanics.term import Amplitudes, DeadLoad, Schedule, Term

if TYPE_CHECKING:
    from skfem import Mesh, MeshHex, MeshHex2

Array = NDArray[np.float64]
Where = Mapping[str, Callable[[Array], NDArray[np.bool_]]]

NEWTON_MM = 1e-8


def curved(block: "MeshHex", named: Where, place: Callable[[Array], Array]) -> "MeshHex2":
    """`block` with all 27 nodes of its elements moved by `place` ((3, N) to (3, N)) [mm].

    Boundaries are named where a function of the facet centres (3, B) of the unmoved block says so.
    """
    from skfem import MeshHex2

    straight = MeshHex2.from_mesh(block)
    return replace(straight, doflocs=place(straight.doflocs)).with_boundaries(block.with_boundaries(named).boundaries)


def wavy(cells: int, element: str) -> "Mesh":
    """The unit cube [mm] in `cells`³ hexahedra whose inner corners are moved by a smooth wave; boundary `all`.

    For an `element` that is a tetrahedron each of them is cut into six.
    """
    from skfem import MeshHex

    mesh = MeshHex.init_tensor(*3 * [np.linspace(0, 1, cells + 1)])
    wave = 0.06 * np.prod(np.sin(np.pi * mesh.p), axis=0)
    moved = MeshHex(mesh.p + wave * np.array([[1.0], [-0.7], [0.8]]), mesh.t)
    fitting = moved.to_meshtet() if ELEMENTS[element].shape.startswith("ElementTet") else moved
    return fitting.with_boundaries({"all": lambda x: np.full(x.shape[1], True)})


def body(
    mesh: "Mesh",
    element: str,
    material: Material,
    held: Mapping[str, str],
    contact: Callable[[Discretisation], Contact] | None = None,
    sideways: Mapping[str, str] | None = None,
) -> Equilibrium:
    """What balances in `mesh`; on its boundary `cavity`, if it has one, acts the load "air".

    Parameters
    ----------
    mesh
        The body [mm].
    element
        One of `pgdl_lab.mechanics.elements.ELEMENTS`.
    material
        Of the whole body.
    held
        Components, as in "xz", that are prescribed on a named boundary; on "body", everywhere.
    contact
        Makes the contact of the skin; None: there is none.
    sideways
        As `held`, for motions that break a symmetry of the body; None: it has none.
    """
    discretisation = discretise(mesh, ELEMENTS[element])

    def free_but(held: Mapping[str, str]) -> NDArray[np.bool_]:
        free = np.ones(discretisation.positions.shape, dtype=bool)
        for name, components in held.items():
            nodes = slice(None) if name == "body" else discretisation.basis.get_dofs(name).all()
            for component in components:
                free[nodes, "xyz".index(component)] = False
        return free

    terms: dict[str, Term] = {"solid": Solid(discretisation, material)}
    if "cavity" in mesh.boundaries:
        terms["air"] = Cavity(discretisation.basis)
    if contact:
        terms["contact"] = contact(discretisation)
    return Equilibrium(terms, free_but(held), None if sideways is None else free_but(sideways))


def settle(equilibrium: Equilibrium, start: Array, amplitudes: Amplitudes | None = None) -> Array:
    """Equilibrium displacement (N, 3) [mm] from `start`, whose values at held degrees of freedom stay."""
    solver = symmetric_solver()
    try:
        return solve(equilibrium, solver, start, amplitudes or {}, NEWTON_MM).displacement
    finally:
        solver.close()


def raise_load(equilibrium: Equilibrium, schedule: Schedule, stop: float, first_step: float) -> Branch:
    """Equilibria from rest as loads follow `schedule` until its parameter is `stop`."""
    solver = symmetric_solver()
    try:
        leg = LoadLeg(equilibrium, solver, NEWTON_MM, schedule)
        return follow(leg, np.zeros(equilibrium.free.shape), stop, first_step, lambda _: None)
    finally:
        solver.close()


def nodes_on(equilibrium: Equilibrium, boundary: str) -> NDArray[np.int64]:
    """Numbers of the nodes on a named boundary."""
    return np.asarray(equilibrium.solid.discretisation.basis.get_dofs(boundary).all(), dtype=np.int64)


def pulled(equilibrium: Equilibrium, boundary: str, traction_mpa: tuple[float, float, float]) -> Equilibrium:
    """`equilibrium` with the dead load "pull" (3,) on each undeformed area of a named boundary [MPa]."""
    body = equilibrium.solid.discretisation
    return equilibrium.with_terms(pull=DeadLoad.traction(body, boundary, np.array(traction_mpa)))


def reaction(
    equilibrium: Equilibrium, displacement: Array, nodes: NDArray[np.int64], amplitudes: Amplitudes | None = None
) -> Array:
    """Sum of the forces (3,) [N] that supports exert on `nodes`."""
    return equilibrium.balance(displacement, amplitudes or {}, stiffness=False).forces[nodes].sum(axis=0)
