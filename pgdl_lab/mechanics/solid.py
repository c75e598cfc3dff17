"""Internal forces of a nearly incompressible hyperelastic solid and their exact tangent.

Two-field form: W = W_iso(Ī₁) + p (J − 1) − p²/(2 K), with the pressure p discontinuous between elements, so that it
condenses out of each element and the stiffness stays symmetric (T. Sussman, K.-J. Bathe, Computers & Structures 26,
1987).

With f = F ∇N and h = F⁻ᵀ ∇N for each shape function N, every term of the tangent but two is a product of f and h. The
stiffness of an element is then one matrix product over its quadrature points, and no fourth-order tensor is formed.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from pgdl_lab.mechanics.elements import Discretisation
from pgdl_lab.mechanics.material import Yeoh

Array = NDArray[np.float64]

CHUNK = 48  # elements at a time: their arrays stay in the cache of one core
_LIBRARIES = ThreadpoolController()


class InvertedElement(Exception):
    """An element is turned inside out: det F ≤ 0 at some quadrature point."""


@dataclass(frozen=True)
class Response:
    """What the solid answers to a displacement.

    Attributes
    ----------
    energy
        Stored elastic energy [N mm].
    forces
        (E, 3 A) derivative of the energy with respect to the nodal displacements of each element [N].
    stiffness
        (E, 3 A, 3 A) second derivative [N/mm]; None if not asked for.
    """

    energy: float
    forces: Array
    stiffness: Array | None


class Solid:
    """The hyperelastic body: energy, forces and stiffness of all its elements."""

    def __init__(self, discretisation: Discretisation, material: Yeoh) -> None:
        self.discretisation = discretisation
        self.material = material

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        """Energy, forces and, if asked for, stiffness at `displacement` (N, 3) [mm].

        Raises
        ------
        InvertedElement
            When det F ≤ 0 at some quadrature point.
        """
        count, nodes = self.discretisation.nodes.shape
        forces = np.empty((count, 3 * nodes))
        matrices = np.empty((count, 3 * nodes, 3 * nodes)) if stiffness else None

        def part(chunk: slice) -> float:
            return self._respond(chunk, displacement, forces, matrices)

        # Two threads over chunks; inside a chunk the matrices are too small for a threaded BLAS.
        with _LIBRARIES.limit(limits=1, user_api="blas"), ThreadPoolExecutor(2) as workers:
            energy = sum(workers.map(part, chunks(count)))
        return Response(energy, forces, matrices)

    def _respond(self, chunk: slice, displacement: Array, forces: Array, matrices: Array | None) -> float:
        """Fill `forces` and `matrices` of the elements in `chunk`; return their energy."""
        mesh, law = self.discretisation, self.material
        grad, w, modes = mesh.gradients[chunk], mesh.weights[chunk], mesh.modes[chunk]
        e, a, _, q = grad.shape
        nodal = displacement[mesh.nodes[chunk]]

        f = np.matmul(nodal.transpose(0, 2, 1), grad.reshape(e, a, 3 * q)).reshape(e, 3, 3, q)
        for i in range(3):
            f[:, i, i] += 1
        h, j = inverse_transpose(f)
        shrink = j ** (-2 / 3)
        invariant = shrink * np.einsum("eijq,eijq->eq", f, f)
        w1, w2 = law.derivatives(invariant)
        dilatation = np.einsum("emq,eq->em", modes, w * (j - 1))
        pressure = law.bulk_modulus_mpa * np.einsum("em,emq->eq", dilatation, modes)

        fg = np.einsum("eijq,eajq->eaiq", f, grad).reshape(e, 3 * a, q)
        hg = np.einsum("eijq,eajq->eaiq", h, grad).reshape(e, 3 * a, q)
        # First Piola stress P = along_f F + along_h F⁻ᵀ.
        along_f = 2 * shrink * w1
        along_h = -2 / 3 * invariant * w1 + pressure * j
        forces[chunk] = (np.matmul(fg, (w * along_f)[..., None]) + np.matmul(hg, (w * along_h)[..., None]))[..., 0]
        energy = float((w * law.energy(invariant)).sum() + law.bulk_modulus_mpa / 2 * (dilatation**2).sum())
        if matrices is None:
            return energy

        ff = 4 * w2 * shrink**2
        fh = -4 / 3 * shrink * (w1 + w2 * invariant)
        hh = 4 / 9 * invariant * (w1 + w2 * invariant) + pressure * j
        volume = np.matmul(hg, (w * j)[..., None] * modes.transpose(0, 2, 1))  # derivative of the dilatation
        left = np.concatenate(
            [
                (w * ff)[:, None] * fg + (w * fh)[:, None] * hg,
                (w * fh)[:, None] * fg + (w * hh)[:, None] * hg,
                law.bulk_modulus_mpa * volume,
            ],
            axis=2,
        )
        right = np.concatenate([fg, hg, volume], axis=2)
        matrix = np.matmul(left, right.transpose(0, 2, 1)).reshape(e, a, 3, a, 3)
        # −along_h h_ak h_bi: an outer product with its two components exchanged.
        exchanged = np.matmul((w * -along_h)[:, None] * hg, hg.transpose(0, 2, 1)).reshape(e, a, 3, a, 3)
        matrix += exchanged.transpose(0, 1, 4, 3, 2)
        flat = grad.reshape(e, a, 3 * q)
        laplace = np.matmul(flat * np.tile(w * along_f, 3)[:, None], flat.transpose(0, 2, 1))
        for i in range(3):
            matrix[:, :, i, :, i] += laplace
        matrices[chunk] = matrix.reshape(e, 3 * a, 3 * a)
        return energy


def chunks(count: int) -> Iterator[slice]:
    """Slices that cover `count` elements."""
    return (slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK))


def inverse_transpose(f: Array) -> tuple[Array, Array]:
    """F⁻ᵀ (E, 3, 3, Q) and det F (E, Q) of `f` (E, 3, 3, Q).

    Raises
    ------
    InvertedElement
        When a determinant is not positive.
    """
    cofactor = np.empty_like(f)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            n, o = (m + 1) % 3, (m + 2) % 3
            cofactor[:, i, m] = f[:, j, n] * f[:, k, o] - f[:, j, o] * f[:, k, n]
    determinant = np.einsum("ejq,ejq->eq", f[:, 0], cofactor[:, 0])
    if not (determinant > 0).all():
        raise InvertedElement
    return cofactor / determinant[:, None, None], determinant
