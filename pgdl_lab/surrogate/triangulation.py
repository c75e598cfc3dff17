"""Functions on a triangulated body: modes, interpolation and derivatives that never look across a slot."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from pgdl_lab.core.simplices import SimplexMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Triangulation(SimplexMesh):
    """A triangulated plane body, see `SimplexMesh`, and what models learn on it."""

    @cached_property
    def _edges(self) -> tuple[Floats, Floats]:
        """Edge vectors opposite to each corner (T, 3, 2) [mm] and signed areas (T,) [mm²]."""
        corners = self.points_mm[self.simplices]
        edges = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
        areas = (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2
        return edges, areas

    def modes(self, count: int) -> tuple[Floats, Floats]:
        """Eigenfunctions of the Laplacian on the body with free edges, the constant left out.

        Linear triangles: −∇²φ = λ φ in the body, ∂φ/∂n = 0 on its edge.

        Parameters
        ----------
        count
            How many, from the lowest eigenvalue.

        Returns
        -------
        The functions (N, count) at the points, of mean square 1 over the body, and their eigenvalues (count,) [1/mm²].
        """
        edges, areas = self._edges
        size = np.abs(areas)
        local = np.einsum("tai,tbi,t->tab", edges, edges, 1 / (4 * size)), size[:, None, None] / 12 * (np.eye(3) + 1)
        row, column = np.repeat(self.simplices, 3, axis=1).ravel(), np.tile(self.simplices, 3).ravel()
        shape = (len(self.points_mm),) * 2
        stiffness, mass = (sp.csc_matrix((np.ravel(part), (row, column)), shape=shape) for part in local)
        # the shift lies just below the constant's eigenvalue 0, so that the matrix can be factorised
        shift = -1e-4 / size.sum()
        values, functions = eigsh(stiffness, count + 1, mass, sigma=shift, v0=np.ones(shape[0]))
        return functions[:, 1:] * np.sqrt(size.sum()), values[1:]

    @cached_property
    def kinks(self) -> sp.csr_matrix:
        """(E, N) matrix that turns nodal values into the kinks of the linear interpolant at the E inner edges.

        A kink is the jump of the normal derivative, times the edge by the root of the area that belongs to it. The sum
        of their squares is the bending energy of a plate of flat triangles (M. Bergou et al., A quadratic bending model
        for inextensible surfaces, 2006), an integral of squared second derivatives. Linear functions have none, at free
        edges nothing is asked for, and nothing acts across a slot.
        """
        edges, areas = self._edges
        gradients = np.stack([-edges[..., 1], edges[..., 0]], axis=-1) / (2 * areas[:, None, None])
        ends = np.sort(np.concatenate([np.roll(self.simplices, -1 - c, axis=1)[:, :2] for c in range(3)]), axis=1)
        order = np.lexsort(ends.T)
        first = np.flatnonzero((ends[order[1:]] == ends[order[:-1]]).all(axis=1))
        sides = np.stack([order[first], order[first + 1]], axis=1) % len(self.simplices)  # triangles on both sides
        along = np.diff(self.points_mm[ends[order[first]]], axis=1)[:, 0]
        length = np.linalg.norm(along, axis=1)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        size = np.abs(areas)[sides].sum(axis=1) / 3  # the part of the body that belongs to an edge
        jump = np.einsum("esci,ei->esc", gradients[sides], normal) * (length / np.sqrt(size))[:, None, None]
        jump[:, 1] *= -1
        row = np.repeat(np.arange(len(sides)), 6)
        shape = (len(sides), len(self.points_mm))
        return sp.csr_matrix((jump.ravel(), (row, self.simplices[sides].ravel())), shape=shape)

    @cached_property
    def derivatives(self) -> list[sp.csr_matrix]:
        """Five (N, N) matrices that turn nodal values into nodal ∂x, ∂z [1/mm] and ∂xx, ∂zz, ∂xz [1/mm²].

        At each point a quadratic is fitted by least squares to the values on the points around it that are reached
        along the body's edges (Z. Zhang & A. Naga, A new finite element gradient recovery method, 2005).
        """
        around = (self._adjacent @ self._adjacent).tocsr()
        wider = (around @ self._adjacent).tocsr()
        narrow = np.diff(around.indptr) < 12  # of 6 coefficients; twice as many values keep the fit from being ragged
        rows, columns, values = [], [], []
        for reach, those in ((around, ~narrow), (wider, narrow)):
            for nodes, patch in _by_number(reach, those):
                offset = self.points_mm[patch] - self.points_mm[nodes, None]
                length = np.abs(offset).max(axis=(1, 2), keepdims=True)
                x, z = np.moveaxis(offset / length, 2, 0)
                quadratic = np.stack([np.ones_like(x), x, z, x * x / 2, z * z / 2, x * z], axis=2)
                fit = np.linalg.pinv(quadratic)[:, 1:] / length ** np.array([1, 1, 2, 2, 2])[:, None]
                rows.append(np.repeat(nodes, patch.shape[1]))
                columns.append(patch.ravel())
                values.append(np.moveaxis(fit, 1, 0).reshape(5, -1))
        row, column = np.concatenate(rows), np.concatenate(columns)
        shape = (len(self.points_mm),) * 2
        return [sp.csr_matrix((value, (row, column)), shape=shape) for value in np.concatenate(values, axis=1)]

    @cached_property
    def _adjacent(self) -> sp.csr_matrix:
        """(N, N), not zero for points that an edge joins and for each with itself."""
        count = len(self.points_mm)
        pairs = self.simplices[:, [0, 1, 2, 1, 2, 0]].T.ravel(), self.simplices[:, [1, 2, 0, 0, 1, 2]].T.ravel()
        joined = sp.csr_matrix((np.ones(len(pairs[0])), pairs), shape=(count, count))
        return joined + sp.identity(count, format="csr")

    @cached_property
    def rings(self) -> tuple[Ints, Ints, Floats]:
        """Points (M,) inside a triangle of points that edges join to them, its corners (M, 3) and their weights (M, 3).

        Of several triangles that with the corners nearest to the point.
        """
        found = []
        for nodes, patch in _by_number(self._adjacent, np.diff(self._adjacent.indptr) > 3):
            ring = patch[patch != nodes[:, None]].reshape(len(nodes), -1)
            triples = np.array(list(combinations(range(ring.shape[1]), 3)))
            corners = ring[:, triples]
            offset = self.points_mm[corners] - self.points_mm[nodes, None, None]
            after, last = np.roll(offset, -1, axis=2), np.roll(offset, -2, axis=2)
            parts = after[..., 0] * last[..., 1] - after[..., 1] * last[..., 0]  # twice the areas opposite to corners
            whole = parts.sum(axis=2, keepdims=True)
            with np.errstate(divide="ignore", invalid="ignore"):
                weights = np.where(np.abs(whole) > 1e-9 * np.abs(parts).max(), parts / whole, np.nan)
            distance = (weights * (offset**2).sum(axis=3)).sum(axis=2)
            distance[~(weights.min(axis=2) > -1e-9)] = np.inf
            best = distance.argmin(axis=1)
            row = np.flatnonzero(np.isfinite(distance.min(axis=1)))
            found.append((nodes[row], corners[row, best[row]], weights[row, best[row]]))
        points, triangles, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return points, triangles, weights


def _by_number(reach: sp.csr_matrix, those: NDArray[np.bool_]) -> Iterator[tuple[Ints, Ints]]:
    """Nodes (G,) of `those` (N,) that reach the same number K of nodes, and these (G, K), for one K after the other."""
    numbers = np.diff(reach.indptr)
    for number in np.unique(numbers[those]):
        nodes = np.flatnonzero(those & (numbers == number))
        yield nodes, reach.indices[reach.indptr[nodes][:, None] + np.arange(number)].astype(np.int64)
