"""The air in cavities that a grid of elements fills: its volume ∫ det F and the derivatives of that.

What the displacement does inside a cavity has no effect: by Gauss's theorem the volume depends on its boundary alone.
"""

import numpy as np

from pgdl_lab.mechanics.cavity import Array, Chamber
from pgdl_lab.mechanics.elements import Discretisation
from pgdl_lab.mechanics.term import Response


class Air(Chamber):
    """Elements in the place of the air, moved by the displacement that the walls around them have.

    Parameters
    ----------
    discretisation
        The elements that fill the undeformed cavities.
    """

    def __init__(self, discretisation: Discretisation) -> None:
        self._elements = discretisation
        self.nodes = discretisation.nodes

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        grad, w = self._elements.gradients, -self._elements.weights  # (E, A, 3, Q), (E, Q)
        f = np.einsum("eai,eajq->eijq", displacement[self.nodes], grad, optimize=True)
        for i in range(3):
            f[:, i, i] += 1
        rows = [np.cross(f[:, (i + 1) % 3], f[:, (i + 2) % 3], axis=1) for i in range(3)]
        cofactor = np.stack(rows, axis=1)
        energy = float((w * (f[:, 0] * cofactor[:, 0]).sum(axis=1)).sum())
        forces = np.einsum("eq,eijq,eajq->eai", w, cofactor, grad, optimize=True)
        elements, nodes = self.nodes.shape
        if not stiffness:
            return Response(energy, forces.reshape(elements, -1), None)
        # d²(det F) couples the rows i and j of F through the third: F_k · (∇N_a × ∇N_b).
        blocks = np.zeros((elements, nodes, 3, nodes, 3))
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            turned = np.cross(w[:, None, None] * f[:, None, k], grad, axis=2)  # F_k × ∇N_a
            coupling = np.einsum("eamq,ebmq->eab", turned, grad, optimize=True)
            blocks[:, :, i, :, j] = coupling
            blocks[:, :, j, :, i] = coupling.transpose(0, 2, 1)
        return Response(energy, forces.reshape(elements, -1), blocks.reshape(elements, 3 * nodes, 3 * nodes))
