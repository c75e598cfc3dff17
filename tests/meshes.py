"""Meshes of bricks, as users make them: with NumPy and meshio, apart from the code that reads them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FACES = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
CORNER = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
PIECES = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]

LENGTH = tuple(np.linspace(0.0, 40.0, 9))
WIDTH, HEIGHT = (-6.0, -3.0, 3.0, 6.0), (0.0, 5.0, 9.0, 12.0)


def chamber(i: int, j: int, k: int) -> bool:
    """The one closed chamber of the body that `bricks` makes unless told otherwise: 30 × 6 × 4 mm."""
    return 1 <= i <= 6 and j == 1 and k == 1


def bricks(
    hole: Callable[[int, int, int], bool] = chamber,
    xs: tuple[float, ...] = LENGTH,
    ys: tuple[float, ...] = WIDTH,
    zs: tuple[float, ...] = HEIGHT,
) -> tuple[Array, Index]:
    """Points and hexahedra of a 40 × 12 × 12 mm body, without the bricks (i, j, k) that are a `hole`."""
    points = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = np.stack(np.meshgrid(*(np.arange(len(axis) - 1) for axis in (xs, ys, zs)), indexing="ij"), -1).reshape(
        -1, 3
    )
    solid = cells[[not hole(*cell) for cell in cells.tolist()]]
    at = solid[:, None] + CORNER
    used, number = np.unique((at[..., 0] * len(ys) + at[..., 1]) * len(zs) + at[..., 2], return_inverse=True)
    return points[used], number.reshape(-1, 8)


def skin(cells: Index) -> Index:
    """Quads or triangles that belong to one of `cells` alone."""
    faces = FACES if cells.shape[1] == 8 else [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    facets = cells[:, faces].reshape(-1, len(faces[0]))
    _, first, times = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    return facets[first[times == 1]]


def tetrahedra(cells: Index) -> Index:
    """Six tetrahedra for each brick."""
    return cells[:, PIECES].reshape(-1, 4)


def inside(middles: Array, low: tuple[float, ...] = (5, -3, 5), high: tuple[float, ...] = (35, 3, 9)) -> Any:
    """Which facets, by their `middles` (F, 3), lie in or on a box: that of the chamber unless told otherwise."""
    return ((middles > np.array(low) - 0.01) & (middles < np.array(high) + 0.01)).all(axis=1)


def groups(points: Array, facets: Index) -> dict[str, Any]:
    """The masks of the facets of the clamp, at x = 0, and of the chamber."""
    middles = points[facets].mean(axis=1)
    return {"clamp": middles[:, 0] < 1e-6, "cavity": inside(middles)}


def save(path: Path, points: Array, cells: Index, named: Mapping[str, Any] | None = None) -> Path:
    """Write a mesh with the facets of its surface; each group of those is an array of 0 and 1 on all cells."""
    facets = skin(cells)
    named = groups(points, facets) if named is None else named
    blocks = [
        ("hexahedron" if cells.shape[1] == 8 else "tetra", cells),
        ("quad" if facets.shape[1] == 4 else "triangle", facets),
    ]
    arrays: dict[str, Any] = {name: [np.zeros(len(cells)), 1.0 * mask] for name, mask in named.items()}
    meshio.write_points_cells(path, points, blocks, cell_data=arrays)
    return path


def plain() -> tuple[Array, Index, dict[str, Any]]:
    """Points, cells and groups of the body."""
    points, cells = bricks()
    return points, cells, groups(points, skin(cells))


def swapped(cells: Index) -> Index:
    """Every element in the other order, which makes it left-handed."""
    return cells[:, [4, 5, 6, 7, 0, 1, 2, 3]] if cells.shape[1] == 8 else cells[:, [1, 0, 2, 3]]
