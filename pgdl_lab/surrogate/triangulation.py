"""Functions on a body of triangles or tetrahedra: modes, kinks and derivatives that never look across a slot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.simplices import SimplexMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NEAREST = 8  # neighbours of a point in space, of which `rings` looks at each four


class Triangulation(SimplexMesh):
    """A body of triangles or of tetrahedra, see `SimplexMesh`, and what models learn on it."""

    @classmethod
    def of(cls, domain: Domain) -> Triangulation:
        """The simplices between the points of a domain."""
        return cls(domain.points_mm, domain.mesh.simplices)

    @cached_property
    def _facets(self) -> tuple[Floats, Floats]:
        """Normals (S, d + 1, d) of the facets opposite to each corner, as long as these are large, and sizes (S,).

        Lengths in the plane [mm], areas in space [mm²]; sizes of the simplices are signed [mm², mm³].
        """
        corners = self.points_mm[self.simplices]
        after, last = (np.roll(corners, -turns, axis=1) for turns in (1, 2))
        if corners.shape[2] == 2:
            edges = last - after
            areas = (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2
            return np.stack([-edges[..., 1], edges[..., 0]], axis=-1), areas
        outward = np.cross(last - after, np.roll(corners, -3, axis=1) - after) / 2
        outward[:, 1::2] *= -1  # corners that follow each other turn the other way at each second one
        return -outward, np.einsum("si,si->s", outward[:, 0], corners[:, 1] - corners[:, 0]) / 3

    def modes(self, count: int) -> tuple[Floats, Floats]:
        """Eigenfunctions of the Laplacian on the body with free edges, the constant left out.

        Linear elements: −∇²φ = λ φ in the body, ∂φ/∂n = 0 on its edge.

        Parameters
        ----------
        count
            How many, from the lowest eigenvalue.

        Returns
        -------
        The functions (N, count) at the points, of mean square 1 over the body, and their eigenvalues (count,) [1/mm²].
        """
        normals, sizes = self._facets
        size, (corners, d) = np.abs(sizes), normals.shape[1:]
        local = (
            np.einsum("tai,tbi,t->tab", normals, normals, 1 / (d**2 * size)),
            size[:, None, None] / ((d + 1) * (d + 2)) * (np.eye(corners) + 1),
        )
        row, column = np.repeat(self.simplices, corners, axis=1).ravel(), np.tile(self.simplices, corners).ravel()
        shape = (len(self.points_mm),) * 2
        stiffness, mass = (sp.csc_matrix((np.ravel(part), (row, column)), shape=shape) for part in local)
        # the shift lies just below the constant's eigenvalue 0, so that the matrix can be factorised
        shift = -1e-4 / size.sum() ** (2 / d)
        values, functions = eigsh(stiffness, count + 1, mass, sigma=shift, v0=np.ones(shape[0]))
        return functions[:, 1:] * np.sqrt(size.sum()), values[1:]

    @cached_property
    def kinks(self) -> sp.csr_matrix:
        """(E, N) matrix that turns nodal values into the kinks of the linear interpolant at the E inner facets.

        A kink is the jump of the normal derivative, times the facet by the root of the part of the body that belongs to
        it. In the plane the sum of their squares is the bending energy of a plate of flat triangles (M. Bergou et al.,
        A quadratic bending model for inextensible surfaces, 2006); in space it is an integral of squared second
        derivatives too. Linear functions have none, at free edges nothing is asked for, and nothing acts across a slot.
        """
        normals, sizes = self._facets
        corners, d = normals.shape[1:]
        gradients = normals / (d * sizes[:, None, None])
        facets = np.sort(
            np.concatenate([np.roll(self.simplices, -1 - c, axis=1)[:, :d] for c in range(corners)]), axis=1
        )
        order = np.lexsort(facets.T)
        first = np.flatnonzero((facets[order[1:]] == facets[order[:-1]]).all(axis=1))
        sides = np.stack([order[first], order[first + 1]], axis=1) % len(self.simplices)  # simplices on both sides
        across, *others = np.diff(self.points_mm[facets[order[first]]], axis=1).swapaxes(0, 1)
        turned = np.cross(across, others[0]) / 2 if others else np.stack([-across[:, 1], across[:, 0]], axis=1)
        extent = np.linalg.norm(turned, axis=1)
        normal = turned / extent[:, None]
        size = np.abs(sizes)[sides].sum(axis=1) / (d + 1)  # the part of the body that belongs to a facet
        jump = np.einsum("esci,ei->esc", gradients[sides], normal) * (extent / np.sqrt(size))[:, None, None]
        jump[:, 1] *= -1
        row = np.repeat(np.arange(len(sides)), 2 * corners)
        shape = (len(sides), len(self.points_mm))
        return sp.csr_matrix((jump.ravel(), (row, self.simplices[sides].ravel())), shape=shape)

    @cached_property
    def derivatives(self) -> list[sp.csr_matrix]:
        """(N, N) matrices that turn nodal values into nodal first derivatives [1/mm] and then second ones [1/mm²].

        In the plane five: ∂x, ∂z and ∂xx, ∂zz, ∂xz; in space nine, in the same order. At each point a quadratic is
        fitted by least squares to the values on the points around it that are reached along the body's edges (Z. Zhang
        & A. Naga, A new finite element gradient recovery method, 2005).
        """
        d = self.points_mm.shape[1]
        around = (self._adjacent @ self._adjacent).tocsr()
        wider = (around @ self._adjacent).tocsr()
        # twice as many values as coefficients keep the fit from being ragged
        narrow = np.diff(around.indptr) < (d + 1) * (d + 2)
        rows, columns, values = [], [], []
        for reach, those in ((around, ~narrow), (wider, narrow)):
            for nodes, patch in _by_number(reach, those):
                offset = self.points_mm[patch] - self.points_mm[nodes, None]
                length = np.abs(offset).max(axis=(1, 2), keepdims=True)
                along = list(np.moveaxis(offset / length, 2, 0))
                quadratic = np.stack([np.ones_like(along[0]), *along, *products(along)], axis=2)
                orders = np.array([1] * d + [2] * (quadratic.shape[2] - 1 - d))
                fit = np.linalg.pinv(quadratic)[:, 1:] / length ** orders[:, None]
                rows.append(np.repeat(nodes, patch.shape[1]))
                columns.append(patch.ravel())
                values.append(np.moveaxis(fit, 1, 0).reshape(len(orders), -1))
        row, column = np.concatenate(rows), np.concatenate(columns)
        shape = (len(self.points_mm),) * 2
        return [sp.csr_matrix((value, (row, column)), shape=shape) for value in np.concatenate(values, axis=1)]

    @cached_property
    def _adjacent(self) -> sp.csr_matrix:
        """(N, N), not zero for points that an edge joins and for each with itself."""
        count, corners = len(self.points_mm), range(self.simplices.shape[1])
        first, second = np.array([(a, b) for a in corners for b in corners if a != b]).T
        pairs = self.simplices[:, first].T.ravel(), self.simplices[:, second].T.ravel()
        joined = sp.csr_matrix((np.ones(len(pairs[0])), pairs), shape=(count, count))
        return joined + sp.identity(count, format="csr")

    @cached_property
    def rings(self) -> tuple[Ints, Ints, Floats]:
        """Points (M,) inside a simplex of points that edges join to them, its corners and their weights (M, d + 1).

        Of several simplices that with the corners nearest to the point; in space only the nearest points are looked at.
        """
        found, d = [], self.points_mm.shape[1]
        for nodes, patch in _by_number(self._adjacent, np.diff(self._adjacent.indptr) > d + 1):
            ring = patch[patch != nodes[:, None]].reshape(len(nodes), -1)
            if d == 3:
                away = np.linalg.norm(self.points_mm[ring] - self.points_mm[nodes, None], axis=2)
                ring = np.take_along_axis(ring, away.argsort(axis=1, kind="stable")[:, :NEAREST], axis=1)
            corners = ring[:, np.array(list(combinations(range(ring.shape[1]), d + 1)))]
            offset = self.points_mm[corners] - self.points_mm[nodes, None, None]
            # (d!) times the sizes of what is opposite to the corners
            after, last = np.roll(offset, -1, axis=2), np.roll(offset, -d, axis=2)
            if d == 2:
                parts = after[..., 0] * last[..., 1] - after[..., 1] * last[..., 0]
            else:
                parts = (after * np.cross(np.roll(offset, -2, axis=2), last)).sum(axis=3)
                parts[..., 1::2] *= -1  # corners that follow each other turn the other way at each second one
            whole = parts.sum(axis=2, keepdims=True)
            with np.errstate(divide="ignore", invalid="ignore"):
                weights = np.where(np.abs(whole) > 1e-9 * np.abs(parts).max(), parts / whole, np.nan)
            distance = (weights * (offset**2).sum(axis=3)).sum(axis=2)
            distance[~(weights.min(axis=2) > -1e-9)] = np.inf
            best = distance.argmin(axis=1)
            row = np.flatnonzero(np.isfinite(distance.min(axis=1)))
            found.append((nodes[row], corners[row, best[row]], weights[row, best[row]]))
        points, simplices, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return points, simplices, weights


def products(along: Sequence[Floats]) -> list[Floats]:
    """Terms of a quadratic in coordinates (…): half their squares, then their products in pairs."""
    return [each * each / 2 for each in along] + [one * other for one, other in combinations(along, 2)]


def _by_number(reach: sp.csr_matrix, those: NDArray[np.bool_]) -> Iterator[tuple[Ints, Ints]]:
    """Nodes (G,) of `those` (N,) that reach the same number K of nodes, and these (G, K), for one K after the other."""
    numbers = np.diff(reach.indptr)
    for number in np.unique(numbers[those]):
        nodes = np.flatnonzero(those & (numbers == number))
        yield nodes, reach.indices[reach.indptr[nodes][:, None] + np.arange(number)].astype(np.int64)
