"""Whether a deformed body overlaps itself, from the places of its elements alone.

It knows no surface, no chamber and no plane of symmetry, so it can judge what does: two elements that have no corner in
common must not have a place in common.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.mechanics.vtk import HEXAHEDRON

Array = NDArray[np.float64]

DEEP_MM = 0.05
"""How far inside its own element a point lies that no other may hold: what overlaps less is not seen."""
CUTS = 4  # parts of an element's edge; each part is six tetrahedra
CORNERS = np.array(list(product((0, 1), repeat=3)))
SIX = np.array([[0, 4, 6, 7], [0, 4, 5, 7], [0, 2, 6, 7], [0, 2, 3, 7], [0, 1, 5, 7], [0, 1, 3, 7]])
"""Tetrahedra that fill a cube with `CORNERS`."""


def overlaps(body: Dataset) -> bool:
    """Whether hexahedra of `body`, and of its mirror image if it is half a body, overlap at its highest pressure."""
    rest, deformed = _mirrored(body.domain.points_mm[body.domain.cells], body.displacements[-1][body.domain.cells])
    nodes = rest.shape[1]
    powers = np.array(list(product(range(3), repeat=3)))
    if nodes == 20:  # serendipity: one square at most
        powers = powers[(powers == 2).sum(axis=1) < 2]
    coefficients = np.linalg.solve(_monomials(2 * HEXAHEDRON[:nodes] - 1, powers), deformed)

    size = rest.max(axis=1) - rest.min(axis=1)
    grid = np.array(list(product(np.linspace(-1, 1, CUTS + 1), repeat=3)))
    deep = np.maximum(1 - 2 * DEEP_MM / size, 0)[:, None]
    points = _monomials(np.clip(grid, -deep, deep), powers) @ coefficients
    start = np.array(list(product(range(CUTS), repeat=3)))
    cubes = (start[:, None] + CORNERS) @ np.array([(CUTS + 1) ** 2, CUTS + 1, 1])  # (C, 8) places in the grid
    tetrahedra = (_monomials(grid, powers) @ coefficients)[:, cubes[:, SIX].reshape(-1, 4)]
    box = rest.min(axis=1), rest.max(axis=1)
    return any(_holds_another(number, points, tetrahedra[number], box) for number in range(len(rest)))


def _mirrored(rest: Array, moved: Array) -> tuple[Array, Array]:
    """Undeformed and deformed places of the nodes of each element; with the mirror images of half a body."""
    if rest[..., 1].min() < -1e-6:
        return rest, rest + moved
    flip = np.array([1.0, -1.0, 1.0])
    return np.concatenate([rest, rest * flip]), np.concatenate([rest + moved, (rest + moved) * flip])


def _monomials(points: Array, powers: NDArray[np.int64]) -> Array:
    result: Array = np.prod(points[..., None, :] ** powers, axis=-1)
    return result


def _holds_another(number: int, points: Array, tetrahedra: Array, box: tuple[Array, Array]) -> bool:
    """Whether a point (E, G, 3) of an element that is no neighbour lies in `tetrahedra` (T, 4, 3) of this one.

    `box` are the least and greatest coordinates (E, 3) of the undeformed elements.
    """
    from scipy.spatial import cKDTree

    low, high = box
    apart = ((low > high[number] + 1e-6) | (high < low[number] - 1e-6)).any(axis=1)
    at = points[apart].reshape(-1, 3)
    corners = tetrahedra.reshape(-1, 3)
    at = at[((at > corners.min(axis=0)) & (at < corners.max(axis=0))).all(axis=1)]
    if not len(at):
        return False
    centre = tetrahedra.mean(axis=1)
    radius = np.linalg.norm(tetrahedra - centre[:, None], axis=2).max(axis=1)
    for tetrahedron, near in zip(tetrahedra, cKDTree(at).query_ball_point(centre, radius), strict=True):
        edges = (tetrahedron[1:] - tetrahedron[0]).T
        if near and abs(np.linalg.det(edges)) > 0:
            weights = np.linalg.solve(edges, (at[near] - tetrahedron[0]).T)
            if ((weights >= 0).all(axis=0) & (weights.sum(axis=0) <= 1)).any():
                return True
    return False
