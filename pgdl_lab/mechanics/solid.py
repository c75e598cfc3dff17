"""Internal forces of a nearly incompressible hyperelastic solid and their exact tangent.

Two-field form: W = W_iso + p (J − 1) − p²/(2 K), with the pressure p discontinuous between elements, so that it
condenses out of each element and the stiffness stays symmetric (T. Sussman, K.-J. Bathe, Computers & Structures 26,
1987).

A law of the first invariant is short: with f = F ∇N and h = F⁻ᵀ ∇N for each shape function N, every term of the tangent
but two is a product of f and h. The stiffness of an element is then one matrix product over its quadrature points, and
no fourth-order tensor is formed. Any other law gives its second Piola–Kirchhoff stress and its tangent.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from pgdl_lab.mechanics.elements import Discretisation
from pgdl_lab.mechanics.invariants import COLUMNS, PLACES, ROWS
from pgdl_lab.mechanics.material import FirstInvariantMaterial, Material
from pgdl_lab.mechanics.term import Response, Term
from pgdl_lab.mechanics.threads import threads

Array = NDArray[np.float64]

CHUNK = 48  # elements at a time: their arrays stay in the cache of one core
_LIBRARIES = ThreadpoolController()


class InvertedElement(Exception):
    """An element is turned inside out: det F ≤ 0 at some quadrature point."""


class Solid(Term):
    """The hyperelastic body, and the elastic energy that it stores.

    Parameters
    ----------
    discretisation
        Its elements.
    material
        What they are made of.
    pressure
        (E, Q) [MPa], at which forces and stiffness are taken; None: the pressure that goes with the displacement.
    """

    def __init__(self, discretisation: Discretisation, material: Material, pressure: Array | None = None) -> None:
        self.discretisation, self.material, self._given = discretisation, material, pressure
        self.nodes = discretisation.nodes

    def at_pressure(self, pressure: Array) -> "Solid":
        """The same with a given pressure (E, Q) [MPa] in it."""
        return Solid(self.discretisation, self.material, pressure)

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        """As for all terms.

        Raises
        ------
        InvertedElement
            When det F ≤ 0 at some quadrature point.
        """
        count, nodes = self.discretisation.nodes.shape
        forces = np.empty((count, 3 * nodes))
        matrices = np.empty((count, 3 * nodes, 3 * nodes)) if stiffness else None

        def part(chunk: slice) -> float:
            given = None if self._given is None else self._given[chunk]
            return self._respond(chunk, displacement, given, forces, matrices)

        # Threads over chunks; inside a chunk the matrices are too small for a threaded BLAS.
        with _LIBRARIES.limit(limits=1, user_api="blas"), ThreadPoolExecutor(threads()) as workers:
            energy = sum(workers.map(part, chunks(count)))
        return Response(energy, forces, matrices)

    def pressure(self, displacement: Array) -> Array:
        """Pressure (E, Q) [MPa] that goes with `displacement` (N, 3) [mm]: the bulk modulus times the dilatation."""
        mesh = self.discretisation
        f = np.einsum("eai,eajq->eijq", displacement[mesh.nodes], mesh.gradients) + np.eye(3)[:, :, None]
        dilatation = np.einsum("emq,eq->em", mesh.modes, mesh.weights * (inverse_transpose(f)[1] - 1))
        result: Array = self.material.bulk_modulus_mpa * np.einsum("em,emq->eq", dilatation, mesh.modes)
        return result

    def _respond(
        self, chunk: slice, displacement: Array, pressure: Array | None, forces: Array, matrices: Array | None
    ) -> float:
        """Fill `forces` and `matrices` of the elements in `chunk`; return their energy."""
        mesh, law = self.discretisation, self.material
        grad, w, modes = mesh.gradients[chunk], mesh.weights[chunk], mesh.modes[chunk]
        e, a, _, q = grad.shape
        nodal = displacement[mesh.nodes[chunk]]

        f = np.matmul(nodal.transpose(0, 2, 1), grad.reshape(e, a, 3 * q)).reshape(e, 3, 3, q)
        for i in range(3):
            f[:, i, i] += 1
        h, j = inverse_transpose(f)
        dilatation = np.einsum("emq,eq->em", modes, w * (j - 1))
        if pressure is None:
            pressure = law.bulk_modulus_mpa * np.einsum("em,emq->eq", dilatation, modes)
        hg = np.einsum("eijq,eajq->eaiq", h, grad).reshape(e, 3 * a, q)
        volume = None
        if matrices is not None:
            volume = np.matmul(hg, (np.sqrt(law.bulk_modulus_mpa) * w * j)[..., None] * modes.transpose(0, 2, 1))

        state = _State(grad, w, f, j, hg, pressure * j, volume)
        if isinstance(law, FirstInvariantMaterial):
            energy, forces[chunk], matrix = _first_invariant(law, state)
        else:
            energy, forces[chunk], matrix = _isochoric(law, state)
        if matrices is not None:
            matrices[chunk] = matrix
        return energy + float(law.bulk_modulus_mpa / 2 * (dilatation**2).sum())


@dataclass(frozen=True)
class _State:
    """The deformation of E elements.

    Attributes
    ----------
    gradients, weights
        As in `Discretisation`.
    f
        (E, 3, 3, Q) deformation gradient F.
    j
        (E, Q) its determinant.
    h
        (E, 3 A, Q) F⁻ᵀ ∇N of each shape function and component [1/mm].
    swelling
        (E, Q) pressure times det F [MPa].
    volume
        (E, 3 A, M) derivative of the dilatation, times the root of the bulk modulus; None if no stiffness is wanted.
    """

    gradients: Array
    weights: Array
    f: Array
    j: Array
    h: Array
    swelling: Array
    volume: Array | None

    def matrix(self, product: Array, along_h: Array, laplace: Array) -> Array:
        """Stiffness (E, 3 A, 3 A) from its parts.

        Parameters
        ----------
        product
            (E, 3 A, 3 A) all that is a product of vectors; it is overwritten [N/mm].
        along_h
            (E, Q) part of the first Piola stress along F⁻ᵀ, times the weights [N mm].
        laplace
            (E, A, A) what each component of the displacement has by itself [N/mm].
        """
        e, a = self.gradients.shape[:2]
        matrix = product.reshape(e, a, 3, a, 3)
        # −along_h h_ak h_bi: an outer product with its two components exchanged.
        exchanged = np.matmul(-along_h[:, None] * self.h, self.h.transpose(0, 2, 1)).reshape(e, a, 3, a, 3)
        matrix += exchanged.transpose(0, 1, 4, 3, 2)
        for i in range(3):
            matrix[:, :, i, :, i] += laplace
        return product


def _first_invariant(law: FirstInvariantMaterial, state: _State) -> tuple[float, Array, Array | None]:
    """Isochoric energy, forces and, if `state` has what it takes, stiffness for a law W_iso(Ī₁)."""
    grad, w, hg = state.gradients, state.weights, state.h
    e, a, _, q = grad.shape
    shrink = state.j ** (-2 / 3)
    invariant = shrink * np.einsum("eijq,eijq->eq", state.f, state.f)
    w1, w2 = law.derivatives(invariant)
    fg = np.einsum("eijq,eajq->eaiq", state.f, grad).reshape(e, 3 * a, q)
    # First Piola stress P = along_f F + along_h F⁻ᵀ.
    along_f = 2 * shrink * w1
    along_h = -2 / 3 * invariant * w1 + state.swelling
    forces = (np.matmul(fg, (w * along_f)[..., None]) + np.matmul(hg, (w * along_h)[..., None]))[..., 0]
    energy = float((w * law.energy(invariant)).sum())
    if state.volume is None:
        return energy, forces, None

    ff = w * (4 * w2 * shrink**2)
    fh = w * (-4 / 3 * shrink * (w1 + w2 * invariant))
    hh = w * (4 / 9 * invariant * (w1 + w2 * invariant) + state.swelling)
    left = [ff[:, None] * fg + fh[:, None] * hg, fh[:, None] * fg + hh[:, None] * hg, state.volume]
    product = outer(left, [fg, hg, state.volume])
    flat = grad.reshape(e, a, 3 * q)
    laplace = np.matmul(flat * np.tile(w * along_f, 3)[:, None], flat.transpose(0, 2, 1))
    return energy, forces, state.matrix(product, w * along_h, laplace)


def _isochoric(law: Material, state: _State) -> tuple[float, Array, Array | None]:
    """As `_first_invariant`, for any law."""
    grad, w, hg = state.gradients, state.weights, state.h
    e, a, _, q = grad.shape
    answer = law.isochoric(
        np.einsum("eijq,eikq->jkeq", state.f, state.f)[ROWS, COLUMNS], tangent=state.volume is not None
    )
    stress = (w * answer.stress)[PLACES]
    flat = grad.reshape(e, a, 3 * q)
    first_piola = np.einsum("eijq,jkeq->ekqi", state.f, stress).reshape(e, 3 * q, 3)
    forces = np.matmul(flat, first_piola).reshape(e, 3 * a)
    forces += np.matmul(hg, (w * state.swelling)[..., None])[..., 0]
    energy = float((w * answer.energy).sum())
    if answer.tangent is None or state.volume is None:
        return energy, forces, None

    # Strain components for each displacement of a node, the last three doubled.
    slopes = np.repeat(grad.transpose(0, 3, 2, 1), 3, axis=3)  # (E, Q, 3, 3 A)
    columns = np.tile(state.f.transpose(0, 3, 2, 1), (1, 1, 1, a))  # of F, one in each row
    strains = np.empty((e, q, 6, 3 * a))
    for number, (i, k) in enumerate(zip(ROWS, COLUMNS, strict=True)):
        np.multiply(slopes[:, :, i], columns[:, :, k], out=strains[:, :, number])
        if i != k:
            strains[:, :, number] += slopes[:, :, k] * columns[:, :, i]
    stresses = np.matmul(np.moveaxis(w * answer.tangent, (0, 1), (-2, -1)), strains)
    left, right = (each.reshape(e, 6 * q, 3 * a) for each in (stresses, strains))
    product = np.matmul(left.transpose(0, 2, 1), right)
    along_h = w * state.swelling
    product += outer([along_h[:, None] * hg, state.volume], [hg, state.volume])
    pulled = np.einsum("eajq,jkeq->eakq", grad, stress).reshape(e, a, 3 * q)
    laplace = np.matmul(pulled, flat.transpose(0, 2, 1))
    return energy, forces, state.matrix(product, along_h, laplace)


def outer(left: list[Array], right: list[Array]) -> Array:
    """Sum (E, D, D) of the outer products of the columns of `left` with those of `right`, each (E, D, …)."""
    return np.matmul(np.concatenate(left, axis=2), np.concatenate(right, axis=2).transpose(0, 2, 1))


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
