"""The volume of the cavities: air at pressure p does the work p dV, so −p V is its potential energy.

Its first derivative is the follower load on the walls, its second the load stiffness, both exact and symmetric, also
element by element: V = −∫ M x · (x,₁ × x,₂) dA over the walls with their normal out of the solid. For closed walls any
M of unit trace gives the same; with M = diag(½, ½, 0) the part of the boundary of V that is no wall does not contribute
either, where its points and their displacements lie in a plane x = 0 or y = 0 (clamped end, symmetry) or in any plane
z = const (a slab in plane strain). An opening elsewhere must be held: then it adds to V a constant alone.

At held degrees of freedom on the rim of an opening that gradient is no force: there the volume lacks the opening. The
force of the air on the walls is `Cavity.push`, the integral of the normal alone.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import cells_of
from pgdl_lab.mechanics.term import Response, Term

if TYPE_CHECKING:
    from skfem import CellBasis

Array = NDArray[np.float64]

SHARES = np.array([0.5, 0.5, 0.0])  # the diagonal of M


class Chamber(Term):
    """Enclosed air: minus its volume, whose amplitude is the pressure of the air [MPa]."""

    load = True
    nodes: NDArray[np.int64]

    def volume_mm3(self, displacement: Array) -> float:
        """Enclosed volume [mm³] at `displacement` (N, 3) [mm]; of half a body that of the half."""
        return -self.response(displacement, stiffness=False).energy


class Cavity(Chamber):
    """A cavity by its walls: W facets with A nodes each.

    Parameters
    ----------
    basis
        The scikit-fem basis of one displacement component.
    walls
        The facets, by their numbers or the name of their boundary: of one chamber, or of several at one pressure.
    """

    def __init__(self, basis: "CellBasis", walls: "str | NDArray[np.int64]" = "cavity") -> None:
        import skfem

        # Exact for the volume: degree 5 along each direction of a square, 7 on a triangle with a cubic bubble.
        order = 5 if cells_of(basis.mesh) == "hexahedra" else 7
        faces = skfem.FacetBasis(basis.mesh, basis.elem, facets=walls, intorder=order)
        value = np.stack([np.broadcast_to(phi, faces.dx.shape) for (phi,) in faces.basis], axis=1)  # (W, all, Q)
        gradient = np.stack([phi.grad for (phi,) in faces.basis], axis=1)  # (3, all, W, Q)
        normal = np.asarray(faces.normals)
        least = np.eye(3)[np.abs(normal[:, :, 0]).argmin(axis=0)].T[:, :, None]
        first = np.cross(normal, least, axis=0)
        first /= np.linalg.norm(first, axis=0)
        second = np.cross(normal, first, axis=0)

        # Shape functions of nodes off the facet vanish on it, and so do their tangential derivatives.
        on_facet = np.abs(value).max(axis=2) > 1e-9
        kept = np.argsort(~on_facet, axis=1, kind="stable")[:, : on_facet.sum(axis=1).max()]

        def on_walls(field: Array) -> Array:
            return np.take_along_axis(field, kept[:, :, None], axis=1)

        self._positions = basis.doflocs.T
        self.nodes = np.take_along_axis(faces.element_dofs.T.astype(np.int64), kept, axis=1)
        self._value = on_walls(value)
        self._first = on_walls(np.einsum("jawq,jwq->waq", gradient, first))
        self._second = on_walls(np.einsum("jawq,jwq->waq", gradient, second))
        self._weights = faces.dx

    def push(self, displacement: Array) -> Array:
        """Of a unit of pressure on each wall facet, −∫ N n da [mm²]."""
        nodal = (self._positions + displacement)[self.nodes].transpose(0, 2, 1)
        normal = np.cross(nodal @ self._first, nodal @ self._second, axis=1)
        forces = self._value @ (-self._weights[:, None, :] * normal).transpose(0, 2, 1)
        return np.asarray(forces.reshape(len(self.nodes), -1))

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        value, first, second, w = self._value, self._first, self._second, self._weights[:, None, :]
        nodal = (self._positions + displacement)[self.nodes].transpose(0, 2, 1)
        x, x1, x2 = nodal @ value, nodal @ first, nodal @ second  # (W, 3, Q)
        normal = np.cross(x1, x2, axis=1)
        mx = SHARES[:, None] * x
        energy = float((w * mx * normal).sum())
        forces = (
            SHARES * (value @ (w * normal).transpose(0, 2, 1))
            + first @ (w * np.cross(x2, mx, axis=1)).transpose(0, 2, 1)
            + second @ (w * np.cross(mx, x1, axis=1)).transpose(0, 2, 1)
        )
        facets, nodes = self.nodes.shape
        if not stiffness:
            return Response(energy, forces.reshape(facets, -1), None)
        # The triple product M x · (x1 × x2) is linear in each factor: its Hessian couples components i ≠ j through the
        # third.
        blocks = np.zeros((facets, nodes, 3, nodes, 3))
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            tangents = (w * x2)[:, k, None] * first - (w * x1)[:, k, None] * second
            along = value @ tangents.transpose(0, 2, 1)
            turned = first @ ((w * mx)[:, k, None] * second).transpose(0, 2, 1)
            coupling = SHARES[i] * along - SHARES[j] * along.transpose(0, 2, 1) + turned - turned.transpose(0, 2, 1)
            blocks[:, :, i, :, j] = coupling
            blocks[:, :, j, :, i] = coupling.transpose(0, 2, 1)
        return Response(energy, forces.reshape(facets, -1), blocks.reshape(facets, 3 * nodes, 3 * nodes))
