"""How far an equilibrium would move on a finer mesh: the a-posteriori estimate that goes with every simulation.

The displacement is carried over to a mesh with half the edges, and the equilibrium is found there from it, without a
load path. At first the stiffness is taken at the pressure of the coarse solution: a displacement that is carried over
dilates fine elements at random, by little, but enough for their own pressures to be far off. One step of Newton's
method would leave an estimate that is several times too large. Halving the edges along one direction after the other
would be cheaper, but errors of mixed elements differ in sign and do not add up.

The change is not the error. Where errors shrink with the order p of the element, the error is 1 / (1 − 2^(−p)) times
the change: 8/7 of it for displacements of third order, 4/3 for those of second and twice for strains of first, both of
elements with mean dilatation. It is not extrapolated, because with one element or two in a wall errors do not shrink so
yet: on a finger of two chambers the tip's changes from mesh to mesh have the order 1.6 with hex27_p0, and alternate in
sign with hex27_p1 and tet10_p0.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import Discretisation, cells_of
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.newton import NoConvergence
from pgdl_lab.mechanics.quasi_newton import settle
from pgdl_lab.mechanics.solid import InvertedElement, Solid
from pgdl_lab.mechanics.term import Amplitudes

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]

ACCURACY = 0.05  # of the change from one mesh to the other
END = 1e-6  # of the length: nodes so near to the largest x are the end of the finger


@dataclass(frozen=True)
class DiscretisationError:
    """By how much an equilibrium moves when all edges of the mesh are halved.

    Attributes
    ----------
    kpa
        Pressure of the equilibrium [kPa].
    tip_mm
        Largest change of the displacement at the end of the finger [mm].
    tip_percent
        The same, of the largest displacement there [%].
    largest_mm
        Largest change anywhere [mm].
    """

    kpa: float
    tip_mm: float
    tip_percent: float
    largest_mm: float

    @staticmethod
    def of(positions: Array, displacement: Array, change: Array, kpa: float) -> "DiscretisationError":
        """From undeformed nodes, their displacement [mm] and its change [mm], (N, 3) each, at a pressure [kPa]."""
        end = positions[:, 0] >= positions[:, 0].max() - END * np.ptp(positions[:, 0])
        size, moved = np.linalg.norm(change, axis=1), np.linalg.norm(displacement[end], axis=1).max()
        tip_mm = float(size[end].max())
        return DiscretisationError(kpa, tip_mm, float(100 * tip_mm / moved), float(size.max()))


def estimate(
    coarse: Equilibrium, fine: Equilibrium, displacement: Array, kpa: float, amplitudes: Amplitudes
) -> DiscretisationError | None:
    """Estimate the discretisation error of an equilibrium by the one on a finer mesh.

    Parameters
    ----------
    coarse
        What the equilibrium was found with.
    fine
        The same on `refined` of its mesh.
    displacement
        (N, 3) the equilibrium on the coarse mesh [mm].
    kpa
        Its pressure [kPa].
    amplitudes
        Of the loads at this pressure.

    Returns
    -------
    DiscretisationError | None
        None when there is no saying: the displacement cannot be carried over, as an element or a surface would be
        crossed, or the equilibrium on the finer mesh is not found from there.
    """
    start = prolonged(coarse.solid.discretisation, fine.solid.discretisation, displacement)
    pressure = prolonged_pressure(coarse.solid, fine.solid.discretisation, displacement)
    soft, solver = fine.with_terms(solid=fine.solid.at_pressure(pressure)), symmetric_solver()
    try:
        solver.factorise(soft.balance(start, amplitudes, stiffness=True).stiffness)
        change = settle(fine, solver, start, amplitudes, ACCURACY) - start
    except (InvertedElement, NoConvergence):
        return None
    finally:
        solver.close()
    return DiscretisationError.of(fine.solid.discretisation.positions, start, change, kpa)


def refined(mesh: "Mesh") -> "Mesh":
    """`mesh` with every edge halved, and its named boundaries."""
    fine = type(mesh)(mesh.p, mesh.t).refined()  # it would warn that the names are lost
    facets = fine.boundary_facets()
    middle = fine.p[:, fine.facets[:, facets]].mean(axis=1)
    candidates = mesh.t2f[:, parents(mesh, fine)[fine.f2t[0, facets]]]  # facets of the element that each lies in
    corner = mesh.p[:, mesh.facets]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], axis=0)
    normal /= np.linalg.norm(normal, axis=0)
    distance = np.abs(((middle[:, None] - corner.mean(axis=1)[:, candidates]) * normal[:, candidates]).sum(axis=0))
    parent = np.take_along_axis(candidates, distance.argmin(axis=0)[None], axis=0)[0]
    return fine.with_boundaries({name: facets[np.isin(parent, old)] for name, old in mesh.boundaries.items()})


def parents(mesh: "Mesh", fine: "Mesh") -> NDArray[np.int64]:
    """The element of `mesh` that each element of `fine`, its refinement, is a part of."""
    if cells_of(mesh) == "hexahedra":
        return np.arange(fine.nelements) % mesh.nelements  # scikit-fem numbers the parts in turn
    # Corners of a part of a tetrahedron are corners of the whole and middles of its edges: these name all four corners.
    ends = np.hstack([np.tile(np.arange(mesh.nvertices), (2, 1)), mesh.edges])
    named = np.sort(ends[:, fine.t].reshape(8, -1), axis=0)
    first = np.vstack([np.ones((1, fine.nelements), dtype=bool), np.diff(named, axis=0) > 0])
    corners = named.T[first.T].reshape(-1, 4).T
    _, number = np.unique(np.hstack([np.sort(mesh.t, axis=0), corners]), axis=1, return_inverse=True)
    return np.argsort(number[: mesh.nelements])[number[mesh.nelements :]]


def prolonged(coarse: Discretisation, fine: Discretisation, displacement: Array) -> Array:
    """Displacement (M, 3) [mm] of the nodes of `fine`, a refinement of `coarse`, where `displacement` is (N, 3)."""
    basis = coarse.basis
    parent = parents(basis.mesh, fine.basis.mesh)
    local = basis.mapping.invF(fine.positions[fine.nodes].transpose(2, 0, 1), tind=parent)
    values = np.zeros((*fine.nodes.shape, 3))
    for number, nodes in enumerate(coarse.nodes.T):
        shape = np.asarray(basis.elem.gbasis(basis.mapping, local, number, tind=parent)[0])
        values += shape[..., None] * displacement[nodes[parent]][:, None]
    result = np.empty_like(fine.positions)
    result[fine.nodes] = values
    return result


def prolonged_pressure(coarse: Solid, fine: Discretisation, displacement: Array) -> Array:
    """Pressure (E, Q) [MPa] at the quadrature points of `fine`, linear over each element of `coarse`."""
    pressure = coarse.pressure(displacement)
    points, onto = (np.asarray(mesh.basis.global_coordinates()) for mesh in (coarse.discretisation, fine))
    parent = parents(coarse.discretisation.basis.mesh, fine.basis.mesh)
    centre = points.mean(axis=2, keepdims=True)
    coefficients = np.linalg.pinv(_linear(points - centre)) @ pressure[..., None]
    result: Array = (_linear(onto - centre[:, parent]) @ coefficients[parent])[..., 0]
    return result


def _linear(points: Array) -> Array:
    """1, x, y, z (E, Q, 4) at `points` (3, E, Q)."""
    return np.concatenate([np.ones((1, *points.shape[1:])), points]).transpose(1, 2, 0)
