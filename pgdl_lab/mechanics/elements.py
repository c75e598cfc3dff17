"""Finite elements: shape functions and quadrature from scikit-fem, laid out for batched matrix products."""

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError

if TYPE_CHECKING:
    from skfem import CellBasis, Mesh


@dataclass(frozen=True)
class ElementKind:
    """An element for nearly incompressible solids.

    Attributes
    ----------
    cells
        What it discretises: "hexahedra" or "tetrahedra".
    shape
        Name of the scikit-fem element that interpolates each displacement component.
    quadrature_order
        Polynomial order that the quadrature integrates exactly: on hexahedra 3 gives 2×2×2 points, 5 gives 3×3×3;
        on tetrahedra 2 gives 4 points, 5 gives 14 (3 and 4 have negative weights, which the pressure modes exclude).
    pressure_modes
        Size of the discontinuous pressure space of each element: 1 is constant, 4 is linear (1, x, y, z); None takes
        the pressure at each quadrature point from the local dilatation, as a plain displacement element does.
    """

    cells: str
    shape: str
    quadrature_order: int
    pressure_modes: int | None

    @property
    def order(self) -> int:
        """Order of displacements in the length of the edges, where they are smooth; that of strains is one less.

        A constant pressure takes one from that of quadratic displacements (`task=verify`).
        """
        return 2 if self.pressure_modes == 1 else 3


# Ten-node tetrahedra lock with pressure at each point, and are unstable with discontinuous linear pressure. With a
# constant one they did neither in any trial, the nodes on edges let the flow through facets, but strains converge with
# first order only, as with mean dilatation on hexahedra. That with 15 nodes, also
# in the facets and inside, is the conforming element of M. Crouzeix and P.-A. Raviart (RAIRO R3, 1973), stable with
# discontinuous linear pressure (D. Boffi, F. Brezzi, M. Fortin, Mixed Finite Element Methods and Applications, 2013,
# chapter 8). Yet on the walls of fingers it errs more at three times the unknowns, since its strain without dilatation
# is no better; it is the one for bodies a single element thick, where constant pressure is far too soft.
ELEMENTS = {
    "hex20": ElementKind("hexahedra", "ElementHexS2", 3, None),
    "hex27": ElementKind("hexahedra", "ElementHex2", 5, None),
    "hex27_p0": ElementKind("hexahedra", "ElementHex2", 5, 1),
    "hex27_p1": ElementKind("hexahedra", "ElementHex2", 5, 4),
    "tet10": ElementKind("tetrahedra", "ElementTetP2", 2, None),
    "tet10_p0": ElementKind("tetrahedra", "ElementTetP2", 2, 1),
    "tet15_p1": ElementKind("tetrahedra", "ElementTetCCR", 5, 4),
}
BEST = {"hexahedra": "hex27_p1", "tetrahedra": "tet10_p0"}
AUTO = "auto"


def cells_of(mesh: "Mesh") -> str:
    """What `mesh` is made of: "hexahedra" or "tetrahedra"."""
    return "tetrahedra" if len(mesh.t) == 4 else "hexahedra"


def choose(element: str, mesh: "Mesh") -> str:
    """Name of the element for `mesh`: `element`, or the best one there is when `element` is "auto".

    Raises
    ------
    InputError
        When `element` is for other cells.
    """
    cells = cells_of(mesh)
    if element == AUTO:
        return BEST[cells]
    if ELEMENTS[element].cells != cells:
        fitting = [name for name, kind in ELEMENTS.items() if kind.cells == cells]
        raise InputError(
            f"'{element}' is an element for {ELEMENTS[element].cells}, but the mesh has {cells}: "
            f"choose fem=solid and fem.element={AUTO} or one of {', '.join(fitting)}."
        )
    return element


@dataclass(frozen=True)
class Discretisation:
    """Element arrays of a mesh: E elements with A nodes, Q quadrature points and M pressure modes; N nodes in all.

    Attributes
    ----------
    basis
        The scikit-fem basis of one displacement component.
    nodes
        (E, A) int, node numbers.
    positions
        (N, 3) undeformed nodes [mm].
    gradients
        (E, A, 3, Q) shape function gradients in the undeformed body [1/mm].
    weights
        (E, Q) volume of each quadrature point [mm³].
    modes
        (E, M, Q) pressure modes, orthonormal over each element [mm^(−3/2)].
    """

    basis: "CellBasis"
    nodes: NDArray[np.int64]
    positions: NDArray[np.float64]
    gradients: NDArray[np.float64]
    weights: NDArray[np.float64]
    modes: NDArray[np.float64]

    def nodal_volumes(self) -> NDArray[np.float64]:
        """Integral of each shape function over the undeformed body (N,) [mm³]."""
        value = np.stack([np.broadcast_to(phi, self.weights.shape) for (phi,) in self.basis.basis], axis=1)
        volumes = np.einsum("eaq,eq->ea", value, self.weights)
        return np.bincount(self.nodes.ravel(), volumes.ravel(), len(self.positions)).astype(np.float64)

    def nodal_areas(self, facets: "str | NDArray[np.int64]") -> NDArray[np.float64]:
        """Integral of each shape function over facets of the undeformed body (N,) [mm²].

        Parameters
        ----------
        facets
            Their numbers in the mesh, or the name of a boundary.
        """
        import skfem

        faces = skfem.FacetBasis(self.basis.mesh, self.basis.elem, facets=facets, intorder=self.basis.elem.maxdeg)
        areas: NDArray[np.float64] = skfem.LinearForm(lambda v, _: 1.0 * v).assemble(faces)
        return areas


def discretise(mesh: "Mesh", kind: ElementKind) -> Discretisation:
    """Evaluate the shape functions of `kind` on all elements of `mesh` [mm]."""
    import skfem

    logging.getLogger("skfem").setLevel(logging.WARNING)  # it tells of every basis it makes
    basis = skfem.CellBasis(mesh, getattr(skfem, kind.shape)(), intorder=kind.quadrature_order)
    gradients = np.stack([phi.grad for (phi,) in basis.basis])  # (A, 3, E, Q)
    return Discretisation(
        basis=basis,
        nodes=basis.element_dofs.T.astype(np.int64),
        positions=np.ascontiguousarray(basis.doflocs.T),
        gradients=np.ascontiguousarray(gradients.transpose(2, 0, 1, 3)),
        weights=np.ascontiguousarray(basis.dx),
        modes=pressure_modes(np.asarray(basis.global_coordinates()), basis.dx, kind.pressure_modes),
    )


def pressure_modes(points: NDArray[np.float64], weights: NDArray[np.float64], count: int | None) -> NDArray[np.float64]:
    """Orthonormal pressure modes (E, M, Q) on quadrature `points` (3, E, Q) [mm] with `weights` (E, Q) [mm³].

    The modes span 1, x, y, z in physical coordinates: mapped coordinates would lose an order on distorted elements
    (D. N. Arnold, D. Boffi, R. S. Falk, Mathematics of Computation 71, 2002).
    """
    root = np.sqrt(weights)
    if count is None:
        return np.eye(weights.shape[1]) / root[:, None, :]
    centred = points - points.mean(axis=2, keepdims=True)
    scaled = centred / np.abs(centred).max(axis=2, keepdims=True)
    monomials = np.concatenate([np.ones((1, *weights.shape)), scaled])[:count]
    orthonormal, _ = np.linalg.qr((monomials * root).transpose(1, 2, 0))  # over the points of each element
    return np.ascontiguousarray((orthonormal / root[..., None]).transpose(0, 2, 1))
