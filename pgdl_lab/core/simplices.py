"""A body cut into triangles or tetrahedra: where a point lies in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROUNDING = 1e-9  # a weight may be that far below 0 on an inner facet
OFF_BODY = 1e-3  # points may lie off the body by this share of its diagonal, as rounding puts them there
UNCOUNTED = 2**63
AXES = {2: "xz", 3: "xyz"}
"""Names of the coordinates, and of the components of a displacement, by the number of dimensions."""
AT_ONCE = 2**14  # points that are located at once: each is compared with all simplices near it
PAIRS = 2**22  # of a point off the body and a facet that are compared at once


@dataclass(frozen=True)
class SimplexMesh:
    """A body of triangles in the plane (d = 2) or of tetrahedra in space (d = 3).

    Attributes
    ----------
    points_mm
        (N, d) float64 [mm].
    simplices
        (S, d + 1) int64, the corners of each.
    """

    points_mm: Floats
    simplices: Ints

    @property
    def tolerance_mm(self) -> float:
        """Distance from which on a point is off the body [mm]."""
        return OFF_BODY * float(np.linalg.norm(np.ptp(self.points_mm, axis=0)))

    def locate(self, points_mm: Floats) -> tuple[Ints, Floats]:
        """Corners (M, d + 1) of the simplices around points (M, d) [mm], and the points' weights (M, d + 1) on them.

        A point off the body gets those of the nearest point of its outline.
        """
        if len(points_mm) > AT_ONCE:
            parts = [self.locate(points_mm[start : start + AT_ONCE]) for start in range(0, len(points_mm), AT_ONCE)]
            corners, weights = (np.concatenate(each) for each in zip(*parts, strict=True))
            return corners, weights
        origin_mm, cell_mm, table = self.grid
        place = np.floor((points_mm - origin_mm) / cell_mm)
        beyond: NDArray[np.bool_] = np.any((place < 0) | (place >= np.array(table.shape[:-1])), axis=1)
        candidates = table[tuple(np.where(beyond[:, None], 0, place).astype(np.int64).T)]
        first_mm, slopes = self.affine
        offset = points_mm[:, None] - first_mm[candidates]
        later = []
        for corner in np.moveaxis(slopes, 1, 0)[:, candidates]:  # written out: a library's sum has other last bits
            weight = offset[..., 0] * corner[..., 0]
            for axis in range(1, points_mm.shape[1]):
                weight = weight + offset[..., axis] * corner[..., axis]
            later.append(weight)
        rest = 1 - later[0]
        for weight in later[1:]:
            rest = rest - weight
        weights = np.stack([rest, *later], axis=-1)
        least = np.where(candidates < 0, -np.inf, weights.min(axis=-1))
        best, every = least.argmax(axis=1), np.arange(len(points_mm))
        corners = self.simplices[candidates[every, best]]
        inside = np.clip(weights[every, best], 0, None)
        off = np.flatnonzero(beyond | (least[every, best] < -ROUNDING))
        if len(off):
            corners[off], inside[off] = self._nearest(points_mm[off])
        return corners, inside / inside.sum(axis=1, keepdims=True)

    def distance_mm(self, points_mm: Floats, corners: Ints, weights: Floats) -> Floats:
        """Distance (M,) [mm] of points (M, d) from what `locate` gave for them: 0 on the body."""
        return np.linalg.norm(np.einsum("mc,mci->mi", weights, self.points_mm[corners]) - points_mm, axis=1)

    @cached_property
    def affine(self) -> tuple[Floats, Floats]:
        """First corner (S, d) [mm] of each simplex, and the slopes (S, d, d) of its other weights [1/mm]."""
        first, *others = np.moveaxis(self.points_mm[self.simplices], 1, 0)
        edges = [(other - first).T for other in others]
        # written out, as a library's inverse has other last bits on other processors
        if len(edges) == 2:
            (ax, az), (bx, bz) = edges
            slopes = np.array([[bz, -bx], [-az, ax]]) / (ax * bz - az * bx)
        else:
            across = [_cross(edges[(i + 1) % 3], edges[(i + 2) % 3]) for i in range(3)]
            slopes = np.array(across) / (edges[0] * across[0]).sum(axis=0)
        return first, np.ascontiguousarray(np.moveaxis(slopes, 2, 0))

    @cached_property
    def grid(self) -> tuple[Floats, float, Ints]:
        """A grid: lowest corner (d,), edge of a cell [mm], and the simplices (I, …, C) that meet each; −1: none."""
        origin, cell_mm, shape, simplex, cell = self._met
        order = np.argsort(cell, kind="stable")
        filled = np.bincount(cell, minlength=math.prod(shape))
        number = np.arange(len(cell)) - np.repeat(np.cumsum(filled) - filled, filled)
        table = np.full((math.prod(shape), filled.max()), -1)
        table[cell[order], number] = simplex[order]
        return origin, cell_mm, table.reshape(*shape, -1)

    @property
    def table_entries(self) -> int:
        """Entries of the table of `grid`, without making it; 2⁶³ if there are more than can be counted."""
        _, _, shape, _, cell = self._met
        if min(shape) < 1 or math.prod(shape) >= UNCOUNTED:
            return UNCOUNTED
        return math.prod(shape) * int(np.unique(cell, return_counts=True)[1].max())

    @cached_property
    def _met(self) -> tuple[Floats, float, tuple[int, ...], Ints, Ints]:
        """Lowest corner (d,), edge [mm] and numbers of cells of a grid, and all pairs of a simplex and its cell."""
        corners = self.points_mm[self.simplices]
        origin = self.points_mm.min(axis=0)
        cell_mm = float(np.sqrt((np.ptp(corners, axis=1) ** 2).mean()))
        first, last = ((bound(corners, axis=1) - origin) / cell_mm for bound in (np.min, np.max))
        first, last = np.floor(first - ROUNDING).clip(0).astype(np.int64), np.floor(last + ROUNDING).astype(np.int64)
        spans = last - first + 1
        counts = spans.prod(axis=1)
        simplex = np.repeat(np.arange(len(corners)), counts)
        within = np.arange(len(simplex)) - np.repeat(np.cumsum(counts) - counts, counts)
        shape = tuple(int(number) + 1 for number in last.max(axis=0))
        cell, size = np.zeros_like(within), 1
        for axis in reversed(range(len(shape))):
            within, along = np.divmod(within, spans[simplex, axis])
            cell += size * (first[simplex, axis] + along)
            size *= shape[axis]
        return origin, cell_mm, shape, simplex, cell

    @cached_property
    def outline(self) -> Ints:
        """Facets (F, d + 1) that belong to one simplex only: their d corners, then the one across."""
        count = self.simplices.shape[1]
        facets = np.concatenate([np.roll(self.simplices, -c, axis=1) for c in range(count)])
        _, first, uses = np.unique(np.sort(facets[:, :-1], axis=1), axis=0, return_index=True, return_counts=True)
        return facets[first[uses == 1]]

    def _nearest(self, points_mm: Floats) -> tuple[Ints, Floats]:
        """Corners (M, d + 1) and weights (M, d + 1) of the points of the outline nearest to points (M, d) [mm]."""
        count = self.simplices.shape[1]
        corners = np.empty((len(points_mm), count), dtype=np.int64)
        weights, distance = np.zeros((len(points_mm), count)), np.full(len(points_mm), np.inf)
        step = max(1, PAIRS // len(self.outline))
        for begin in range(0, len(points_mm), step):
            some = slice(begin, begin + step)
            for ends in combinations(range(count - 1), 2):  # an edge of each facet; in the plane that is all of it
                self._closer(points_mm, self.outline[:, ends], ends, some, corners, weights, distance)
            if count == 4:
                self._closer(points_mm, self.outline[:, :3], (0, 1, 2), some, corners, weights, distance)
        return corners, weights

    def _closer(
        self, points_mm: Floats, parts: Ints, places: tuple[int, ...], some: slice,
        corners: Ints, weights: Floats, distance: Floats,
    ) -> None:  # fmt: skip
        """Where edges or triangles `parts` (F, 2 or 3) of the outline come nearer to some points, put them there.

        Parameters
        ----------
        places
            Which of its facet's corners those of a part are.
        """
        start, *others = np.moveaxis(self.points_mm[parts], 1, 0)
        edges = np.stack([other - start for other in others])
        offset = points_mm[some, None] - start
        along = np.einsum("pfi,efi->epf", offset, edges)
        if len(edges) == 1:
            share = np.clip(along / (edges[0] ** 2).sum(axis=1), 0, 1)
            inside = np.ones(share.shape[1:], dtype=bool)
        else:
            products = np.einsum("efi,gfi->efg", edges, edges)
            aa, ab, bb = products[0, :, 0], products[0, :, 1], products[1, :, 1]
            share = np.stack([bb * along[0] - ab * along[1], aa * along[1] - ab * along[0]]) / (aa * bb - ab**2)
            inside = (share >= 0).all(axis=0) & (share.sum(axis=0) <= 1)
        foot = np.einsum("epf,efi->pfi", share, edges)
        away = np.where(inside, np.linalg.norm(offset - foot, axis=2), np.inf)
        nearest, every = away.argmin(axis=1), np.arange(len(away))
        nearer = np.flatnonzero(away[every, nearest] < distance[some])
        here, best = some.start + nearer, nearest[nearer]
        distance[here] = away[nearer, best]
        corners[here], weights[here] = self.outline[best], 0.0
        weights[here[:, None], places[1:]] = share[:, nearer, best].T
        weights[here, places[0]] = 1 - share[:, nearer, best].sum(axis=0)


def place(point_mm: Floats, digits: str = "") -> str:
    """A point (d,) in words, such as "x = 3, z = 4 mm", with as many `digits` as a format says."""
    axes = AXES[len(point_mm)]
    return ", ".join(f"{axis} = {float(value):{digits}g}" for axis, value in zip(axes, point_mm, strict=True)) + " mm"


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross products of vectors (3, S), written out."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
