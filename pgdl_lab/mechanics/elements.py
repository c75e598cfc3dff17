"""Finite elements: shape functions and quadrature from scikit-fem, laid out for batched matrix products."""

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from skfem import CellBasis, MeshHex


@dataclass(frozen=True)
class ElementKind:
    """A hexahedral element for nearly incompressible solids.

    Attributes
    ----------
    shape
        Name of the scikit-fem element that interpolates each displacement component.
    quadrature_order
        Polynomial order that the Gauss rule integrates exactly: 3 gives 2×2×2 points, 5 gives 3×3×3.
    pressure_modes
        Size of the discontinuous pressure space of each element: 1 is constant, 4 is linear (1, x, y, z); None takes
        the pressure at each quadrature point from the local dilatation, as a plain displacement element does.
    """

    shape: str
    quadrature_order: int
    pressure_modes: int | None


ELEMENTS = {
    "hex20": ElementKind("ElementHexS2", 3, None),
    "hex27": ElementKind("ElementHex2", 5, None),
    "hex27_p0": ElementKind("ElementHex2", 5, 1),
    "hex27_p1": ElementKind("ElementHex2", 5, 4),
}


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


def discretise(mesh: "MeshHex", kind: ElementKind) -> Discretisation:
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
