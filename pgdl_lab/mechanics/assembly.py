"""From element matrices to one sparse matrix: the pattern is worked out once, each assembly is one weighted count."""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Assembler:
    """Adds up element vectors, and the upper triangle of symmetric element matrices over the free degrees of freedom.

    Parameters
    ----------
    groups
        For each kind of element its node numbers (E, A).
    free
        (N, 3) bool, which displacement components are not held fixed.
    """

    def __init__(self, groups: Sequence[NDArray[np.int64]], free: NDArray[np.bool_]) -> None:
        self.size = int(free.sum())
        self._free = free
        self._dofs = [(3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), -1) for nodes in groups]
        # The pattern is sought among pairs of nodes, of which there are nine times fewer than of components.
        pairs = [np.nonzero(nodes[:, :, None] <= nodes[:, None, :]) for nodes in groups]
        keys = [nodes[e, a] * len(free) + nodes[e, b] for nodes, (e, a, b) in zip(groups, pairs, strict=True)]
        unique, pair = np.unique(np.concatenate(keys), return_inverse=True)
        first, second = np.divmod(unique, len(free))
        used = free[first][:, :, None] & free[second][:, None, :]  # (pairs, 3, 3)
        used &= (first != second)[:, None, None] | np.triu(np.ones((3, 3), dtype=bool))
        slot = self._lay_out(used, first)
        number = np.where(free.ravel(), np.cumsum(free) - 1, -1).reshape(free.shape)
        columns = np.broadcast_to(number[second][:, None, :], used.shape)
        self._indices = np.empty(int(self._indptr[-1]), dtype=np.int32)
        self._indices[slot[used]] = columns[used]

        self._entries: list[NDArray[np.int64]] = []
        places = []
        for nodes, (e, a, b), own in zip(
            groups, pairs, np.split(pair, np.cumsum([len(k) for k in keys])[:-1]), strict=True
        ):
            width = 3 * nodes.shape[1]
            corner = (e * width + 3 * a) * width + 3 * b  # of a 3 × 3 block in the raveled element matrices
            within = width * np.arange(3)[:, None] + np.arange(3)
            wanted = used[own]
            self._entries.append((corner[:, None, None] + within)[wanted])
            places.append(slot[own][wanted])
        self._place = np.concatenate(places)

    def _lay_out(self, used: NDArray[np.bool_], first: NDArray[np.int64]) -> NDArray[np.int64]:
        """Place in the sparse matrix of each component of each pair of nodes that is `used` (pairs, 3, 3).

        `first` holds the first node of each pair, rising. In a row lie the pairs of its node, in each its components.
        """
        in_row = used.sum(axis=2)
        counts = np.zeros(self._free.shape, dtype=np.int64)
        np.add.at(counts, first, in_row)
        starts = np.concatenate([[0], np.cumsum(counts)])
        self._indptr = np.concatenate([[0], np.cumsum(counts.ravel()[self._free.ravel()])]).astype(np.int32)
        before = np.cumsum(in_row, axis=0) - in_row
        group = np.searchsorted(first, first)  # the first pair of the same node
        row_starts = starts[:-1].reshape(self._free.shape)[first] + before - before[group]
        place: NDArray[np.int64] = row_starts[:, :, None] + np.cumsum(used, axis=2) - used
        return place

    def vector(self, *forces: Array | None) -> Array:
        """Sum of the element vectors of each group, (E, 3 A) or None each, at all degrees of freedom: (N, 3)."""
        total = np.zeros(self._free.size)
        for dofs, values in zip(self._dofs, forces, strict=True):
            if values is not None:
                total += np.bincount(dofs.ravel(), values.ravel(), self._free.size)
        return total.reshape(self._free.shape)

    def with_upper(self, upper: sp.csr_matrix, full: sp.csr_matrix) -> sp.csr_matrix:
        """Add to `upper` the upper triangle, at the free degrees, of a symmetric matrix over all degrees (3 N, 3 N).

        Places that are new stay in the pattern of all further matrices, so that a solver seldom orders them anew.
        """
        free = np.flatnonzero(self._free.ravel())
        added = sp.triu(full[free][:, free], format="coo")
        keys = added.row.astype(np.int64) * self.size + added.col
        pattern = np.repeat(np.arange(self.size), np.diff(self._indptr)) * self.size + self._indices
        place, data = np.searchsorted(pattern, keys), upper.data
        unknown = pattern[np.minimum(place, len(pattern) - 1)] != keys
        if unknown.any():
            fresh = np.unique(keys[unknown])
            where = np.searchsorted(pattern, fresh)
            pattern, data = np.insert(pattern, where, fresh), np.insert(data, where, 0.0)
            self._place += np.searchsorted(where, self._place, side="right")
            self._indptr = np.searchsorted(pattern, np.arange(self.size + 1) * self.size).astype(np.int32)
            self._indices = (pattern % self.size).astype(np.int32)
            place = np.searchsorted(pattern, keys)
        total: Array = data + np.bincount(place, added.data, len(data))
        return self._matrix(total)

    def upper(self, *matrices: Array | None) -> sp.csr_matrix:
        """Upper triangle of the sum of each group's element matrices, (E, 3 A, 3 A) or None, at the free degrees.

        The pattern has a place for all of them, also where they are None.
        """
        pairs = zip(matrices, self._entries, strict=True)
        values = np.concatenate([np.zeros(len(used)) if m is None else m.ravel()[used] for m, used in pairs])
        total: Array = np.bincount(self._place, values, len(self._indices)).astype(np.float64, copy=False)
        return self._matrix(total)

    def _matrix(self, data: Array) -> sp.csr_matrix:
        matrix = sp.csr_matrix((data, self._indices, self._indptr), shape=(self.size, self.size))
        matrix.has_sorted_indices = True
        return matrix
