"""The skin of a body: its curved outer faces, and triangles that follow them for the detection of contact."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import Discretisation, cells_of
from pgdl_lab.mechanics.vtk import ordered_cells

if TYPE_CHECKING:
    import ipctk

Array = NDArray[np.float64]

# Of each face its corners, middle nodes and, of 27-node hexahedra only, centre, as places in what
# `pgdl_lab.mechanics.vtk.ordered_cells` gives. A 15-node tetrahedron's face goes without its centre.
HEXAHEDRON = np.array(
    [
        [0, 4, 7, 3, 16, 15, 19, 11, 20],
        [1, 2, 6, 5, 9, 18, 13, 17, 21],
        [0, 1, 5, 4, 8, 17, 12, 16, 22],
        [3, 7, 6, 2, 19, 14, 18, 10, 23],
        [0, 3, 2, 1, 11, 10, 9, 8, 24],
        [4, 5, 6, 7, 12, 13, 14, 15, 25],
    ]
)
TETRAHEDRON = np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]])
# Where the nodes of such a face lie in the unit square, and in the unit triangle; exponents of the polynomials on them.
SQUARE = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 2], [0, 1], [1, 1]]) / 2
TRIANGLE = np.array([[0, 0], [2, 0], [0, 2], [1, 0], [1, 1], [0, 1]]) / 2
BIQUADRATIC = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [2, 0], [0, 2], [2, 1], [1, 2], [2, 2]])
QUADRATIC = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [2, 0], [0, 2]])
# Largest sum of the absolute values of the shape functions of a face but those of its corners, by its number of nodes.
OF_MIDDLES = {6: 1.34, 8: 2.0, 9: 1.39}


def skin(discretisation: Discretisation) -> NDArray[np.int64]:
    """Nodes (F, 6, 8 or 9) of all boundary facets that are not part of a named boundary: corners, middles, centre."""
    mesh = discretisation.basis.mesh
    facets = np.setdiff1d(mesh.boundary_facets(), np.concatenate(list((mesh.boundaries or {}).values())))
    cells = ordered_cells(discretisation)
    owner = cells[mesh.f2t[0, facets]]
    wanted = np.sort(discretisation.basis.nodal_dofs[0, mesh.facets[:, facets]].T, axis=1)
    places = TETRAHEDRON if cells_of(mesh) == "tetrahedra" else HEXAHEDRON[:, : 8 if cells.shape[1] == 20 else 9]
    corners = np.sort(owner[:, places[:, : len(mesh.facets)]], axis=2)
    face = (corners == wanted[:, None]).all(axis=2).argmax(axis=1)
    return np.take_along_axis(owner, places[face], axis=1)


def sampled(faces: NDArray[np.int64], positions: Array, divisions: int) -> "ipctk.CollisionMesh":
    """Triangles that follow the curved `faces` (F, 6, 8 or 9), each of whose edges has `divisions` of theirs.

    Their vertices move as the shape functions say, and hand their forces on to the nodes (N, 3) by them.
    """
    import ipctk
    import scipy.sparse as sp

    count, nodes = faces.shape
    at, triangles = grid(divisions, square=nodes > 6)
    known, powers = (SQUARE[:nodes], BIQUADRATIC[:nodes]) if nodes > 6 else (TRIANGLE, QUADRATIC)
    shape = np.linalg.solve(monomials(known, powers).T, monomials(at, powers).T).T.round(12)
    used = np.abs(shape) > 0
    sample, node = np.nonzero(used)
    row = (np.arange(count)[:, None] * len(at) + sample).ravel()
    weights = sp.csr_matrix(
        (np.tile(shape[used], count), (row, faces[:, node].ravel())), shape=(count * len(at), len(positions))
    )
    # Samples of neighbouring faces that coincide have the same weights: known by their value of a random field.
    mark = weights @ np.random.default_rng(0).random(len(positions))
    order = np.argsort(mark, kind="stable")
    fresh = np.diff(mark[order], prepend=-np.inf) > 1e-12
    number = np.empty(len(mark), dtype=np.int64)
    number[order] = np.cumsum(fresh) - 1
    interpolation = weights[order[fresh]].tocsc()
    all_triangles = number.reshape(count, -1)[:, triangles].reshape(-1, 3).astype(np.int32)
    return ipctk.CollisionMesh(
        np.asfortranarray(interpolation @ positions), ipctk.edges(all_triangles), all_triangles, interpolation
    )


def bulge(faces: NDArray[np.int64], at: Array) -> Array:
    """Bound (F,) on how far curved `faces` with nodes `at` (N, 3) lie from flat triangles on their corners [mm]."""
    x = at[faces]
    corners = 4 if faces.shape[1] > 6 else 3
    chords = (x[:, :corners] + np.roll(x[:, :corners], -1, axis=1)) / 2
    off = np.linalg.norm(x[:, corners : 2 * corners] - chords, axis=2).max(axis=1)
    if faces.shape[1] == 9:
        off = np.maximum(off, np.linalg.norm(x[:, 8] - x[:, :4].mean(axis=1), axis=1))
    result: Array = OF_MIDDLES[faces.shape[1]] * off
    if corners == 4:
        result += np.linalg.norm(x[:, 0] - x[:, 1] + x[:, 2] - x[:, 3], axis=1) / 4  # its twist
    return result


def grid(divisions: int, *, square: bool) -> tuple[Array, NDArray[np.int64]]:
    """Points (G, 2) of a regular grid on the unit square or triangle, and the triangles (T, 3) between them."""
    number: dict[tuple[int, int], int] = {}
    for i in range(divisions + 1):
        for j in range(divisions + 1 if square else divisions + 1 - i):
            number[i, j] = len(number)
    triangles = []
    for i, j in number:
        if (i + 1, j) in number and (i, j + 1) in number:
            triangles.append([number[i, j], number[i + 1, j], number[i, j + 1]])
        if (i + 1, j + 1) in number:
            triangles.append([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]])
    return np.array(list(number)) / divisions, np.array(triangles)


def monomials(points: Array, powers: NDArray[np.int64]) -> Array:
    """Values (G, P) of the polynomials x^a y^b, with (a, b) the rows of `powers` (P, 2), at `points` (G, 2)."""
    return np.asarray((points[:, None] ** powers).prod(axis=2))
