"""The triangulated side face of the undeformed finger: where a point lies on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROUNDING = 1e-9  # a weight may be that far below 0 on an inner edge
OFF_BODY = 1e-3  # points may lie off the body by this share of its diagonal, as rounding puts them there
UNCOUNTED = 2**63
CHUNK = 1024  # points off the body that are compared with all edges at once


@dataclass(frozen=True)
class FaceMesh:
    """A triangulated plane body.

    Attributes
    ----------
    points_mm
        (N, 2) float64 [mm].
    triangles
        (T, 3) int64.
    """

    points_mm: Floats
    triangles: Ints

    @property
    def tolerance_mm(self) -> float:
        """Distance from which on a point is off the body [mm]."""
        return OFF_BODY * float(np.linalg.norm(np.ptp(self.points_mm, axis=0)))

    def locate(self, points_mm: Floats) -> tuple[Ints, Floats]:
        """Corners (M, 3) of the triangles around points (M, 2) [mm], and the points' weights (M, 3) on them.

        A point off the body gets those of the nearest point of its outline.
        """
        origin_mm, cell_mm, table = self.cells
        place = np.floor((points_mm - origin_mm) / cell_mm)
        beyond: NDArray[np.bool_] = np.any((place < 0) | (place >= np.array(table.shape[:2])), axis=1)
        row, column = np.where(beyond[:, None], 0, place).astype(np.int64).T
        candidates = table[row, column]
        first_mm, slopes = self.affine
        offset = points_mm[:, None] - first_mm[candidates]
        second = offset[..., 0] * slopes[candidates, 0, 0] + offset[..., 1] * slopes[candidates, 0, 1]
        third = offset[..., 0] * slopes[candidates, 1, 0] + offset[..., 1] * slopes[candidates, 1, 1]
        weights = np.stack([1 - second - third, second, third], axis=-1)
        least = np.where(candidates < 0, -np.inf, weights.min(axis=-1))
        best, every = least.argmax(axis=1), np.arange(len(points_mm))
        corners = self.triangles[candidates[every, best]]
        inside = np.clip(weights[every, best], 0, None)
        off = np.flatnonzero(beyond | (least[every, best] < -ROUNDING))
        if len(off):
            corners[off], inside[off] = self._nearest(points_mm[off])
        return corners, inside / inside.sum(axis=1, keepdims=True)

    def distance_mm(self, points_mm: Floats, corners: Ints, weights: Floats) -> Floats:
        """Distance (M,) [mm] of points (M, 2) from what `locate` gave for them: 0 on the body."""
        return np.linalg.norm(np.einsum("mc,mci->mi", weights, self.points_mm[corners]) - points_mm, axis=1)

    @cached_property
    def affine(self) -> tuple[Floats, Floats]:
        """First corner (T, 2) [mm] of each triangle, and the slopes (T, 2, 2) of its other two weights [1/mm]."""
        first, second, third = np.moveaxis(self.points_mm[self.triangles], 1, 0)
        (ax, az), (bx, bz) = (second - first).T, (third - first).T
        # written out, as a library's inverse has other last bits on other processors
        slopes = np.array([[bz, -bx], [-az, ax]]) / (ax * bz - az * bx)
        return first, np.ascontiguousarray(np.moveaxis(slopes, 2, 0))

    @cached_property
    def cells(self) -> tuple[Floats, float, Ints]:
        """A grid: lower left corner (2,), edge of a cell [mm], and the triangles (I, K, C) that meet each; −1: none."""
        origin, cell_mm, shape, triangle, cell = self._met
        order = np.argsort(cell, kind="stable")
        filled = np.bincount(cell, minlength=math.prod(shape))
        number = np.arange(len(cell)) - np.repeat(np.cumsum(filled) - filled, filled)
        table = np.full((math.prod(shape), filled.max()), -1)
        table[cell[order], number] = triangle[order]
        return origin, cell_mm, table.reshape(*shape, -1)

    @property
    def table_entries(self) -> int:
        """Entries of the table of `cells`, without making it; 2⁶³ if there are more than can be counted."""
        _, _, shape, _, cell = self._met
        if min(shape) < 1 or math.prod(shape) >= UNCOUNTED:
            return UNCOUNTED
        return math.prod(shape) * int(np.unique(cell, return_counts=True)[1].max())

    @cached_property
    def _met(self) -> tuple[Floats, float, tuple[int, int], Ints, Ints]:
        """Lower left corner (2,), edge [mm] and number of cells of a grid, and all pairs of a triangle and its cell."""
        corners = self.points_mm[self.triangles]
        origin = self.points_mm.min(axis=0)
        cell_mm = float(np.sqrt((np.ptp(corners, axis=1) ** 2).mean()))
        first, last = ((bound(corners, axis=1) - origin) / cell_mm for bound in (np.min, np.max))
        first, last = np.floor(first - ROUNDING).clip(0).astype(np.int64), np.floor(last + ROUNDING).astype(np.int64)
        spans = last - first + 1
        counts = spans.prod(axis=1)
        triangle = np.repeat(np.arange(len(corners)), counts)
        within = np.arange(len(triangle)) - np.repeat(np.cumsum(counts) - counts, counts)
        row, column = first[triangle].T + np.divmod(within, spans[triangle, 1])
        rows, columns = (int(number) + 1 for number in last.max(axis=0))
        return origin, cell_mm, (rows, columns), triangle, row * columns + column

    @cached_property
    def outline(self) -> Ints:
        """Ends (S, 2) of the edges that belong to one triangle only, and the corner across, together (S, 3)."""
        edges = np.concatenate([np.roll(self.triangles, -c, axis=1) for c in range(3)])
        _, first, uses = np.unique(np.sort(edges[:, :2], axis=1), axis=0, return_index=True, return_counts=True)
        return edges[first[uses == 1]]

    def _nearest(self, points_mm: Floats) -> tuple[Ints, Floats]:
        """Corners (M, 3) and weights (M, 3) of the points of the outline that are nearest to points (M, 2) [mm]."""
        start = self.points_mm[self.outline[:, 0]]
        along = self.points_mm[self.outline[:, 1]] - start
        length = (along**2).sum(axis=1)
        chosen, share = np.empty(len(points_mm), dtype=np.int64), np.empty(len(points_mm))
        for begin in range(0, len(points_mm), CHUNK):
            some = slice(begin, begin + CHUNK)
            offset = points_mm[some, None] - start
            foot = np.clip((offset * along).sum(axis=2) / length, 0, 1)
            nearest = ((offset - foot[..., None] * along) ** 2).sum(axis=2).argmin(axis=1)
            chosen[some], share[some] = nearest, foot[np.arange(len(nearest)), nearest]
        return self.outline[chosen], np.stack([1 - share, share, np.zeros_like(share)], axis=1)
