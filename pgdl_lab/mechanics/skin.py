"""The skin of a body: its curved faces, sorted by the air that they touch, and triangles that follow them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import Discretisation, cells_of
from pgdl_lab.mechanics.vtk import ordered_cells

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix
    from skfem import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Of each face its corners, middle nodes and, of 27-node hexahedra only, centre, as places in what
# `pgdl_lab.mechanics.vtk.ordered_cells` gives, going round such that the normal points out of the element. A 15-node
# tetrahedron's face goes without its centre.
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
MIRROR = "symmetry"  # the boundary of half a body in the plane y = 0, where its mirror image begins


@dataclass(frozen=True)
class Samples:
    """Triangles that follow curved faces.

    Attributes
    ----------
    positions
        (V, 3) their undeformed vertices [mm].
    triangles
        (T, 3) int32, vertices of each, going round such that the normal points out of the body.
    interpolation
        (V, N) from displacements of all nodes to those of the vertices.
    """

    positions: Array
    triangles: NDArray[np.int32]
    interpolation: "csr_matrix"


def skin(discretisation: Discretisation, cut: tuple[str, ...] = (MIRROR,)) -> list[Index]:
    """Nodes (F, 6, 8 or 9) of the boundary facets at each air: first that around the body, then each closed chamber.

    Faces at the same air can meet; between others lies the body, however thin it is. On the named boundaries that are
    `cut` the body goes on, so that nothing can touch it there.
    """
    mesh = discretisation.basis.mesh
    named = mesh.boundaries or {}
    inside = np.unique(named.get("cavity", [])).astype(np.int64)
    no_face = [named[name] for name in cut if name in named]
    outside = np.setdiff1d(mesh.boundary_facets(), np.concatenate([inside, *no_face]))
    return [faces_of(discretisation, facets) for facets in [outside, *chambers(mesh, inside)]]


def chambers(mesh: "Mesh", walls: Index) -> list[Index]:
    """The facets `walls` of cavities, those of each chamber for itself.

    Walls that end at the clamp may belong together behind it, and are taken to.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not walls.size:
        return []
    corners = mesh.facets[:, walls]
    at_clamp = np.unique(mesh.facets[:, (mesh.boundaries or {}).get("clamp", [])])
    node = np.where(np.isin(corners, at_clamp), -1, corners) + 1
    links = coo_matrix((np.ones(node.size), (np.tile(np.arange(len(walls)), len(node)), node.ravel()))).tocsr()
    count, chamber = connected_components(links @ links.T, directed=False)
    return [walls[chamber == number] for number in range(count)]


def faces_of(discretisation: Discretisation, facets: Index) -> Index:
    """Nodes (F, 6, 8 or 9) of boundary `facets` (F,): corners, going round, middles, centre."""
    mesh = discretisation.basis.mesh
    cells = ordered_cells(discretisation)
    owner = cells[mesh.f2t[0, facets]]
    wanted = np.sort(discretisation.basis.nodal_dofs[0, mesh.facets[:, facets]].T, axis=1)
    tables = TETRAHEDRON if cells_of(mesh) == "tetrahedra" else HEXAHEDRON[:, : 8 if cells.shape[1] == 20 else 9]
    corners = np.sort(owner[:, tables[:, : len(mesh.facets)]], axis=2)
    face = (corners == wanted[:, None]).all(axis=2).argmax(axis=1)
    return np.take_along_axis(owner, tables[face], axis=1)


def sampled(faces: Index, positions: Array, divisions: int) -> Samples:
    """Triangles that follow the curved `faces` (F, 6, 8 or 9), each of whose edges has `divisions` of theirs.

    Their vertices move as the shape functions say, and hand their forces on to the nodes (N, 3) by them.
    """
    import scipy.sparse as sp

    count, nodes = faces.shape
    at, triangles = grid(divisions, square=nodes > 6)
    known, powers = (SQUARE[:nodes], BIQUADRATIC[:nodes]) if nodes > 6 else (TRIANGLE, QUADRATIC)
    shape = np.linalg.solve(monomials(known, powers).T, monomials(at, powers).T).T.round(12)
    _, fresh, number = np.unique(places(faces, at, divisions), return_index=True, return_inverse=True)
    used = np.abs(shape) > 0
    face, sample = np.divmod(fresh, len(at))
    row = np.repeat(np.arange(len(fresh)), used.sum(axis=1)[sample])
    column, weight = faces[face][used[sample]], shape[sample][used[sample]]
    interpolation = sp.csr_matrix((weight, (row, column)), shape=(len(fresh), len(positions)))
    corners = number.reshape(count, -1)[:, triangles].reshape(-1, 3)
    return Samples(interpolation @ positions, corners.astype(np.int32), interpolation)


def places(faces: Index, at: Array, divisions: int) -> Index:
    """A number (F G,) for the place of each of the points `at` (G, 2) of each face: the same where faces meet.

    A corner is told by its node, a point of an edge by the nodes at both ends and how far it is from the one with the
    lower number; a point inside belongs to one face alone.
    """
    ends = SQUARE[:4] if faces.shape[1] > 6 else TRIANGLE[:3]
    number = -1 - np.arange(len(faces) * len(at)).reshape(len(faces), -1)
    for first, second in zip(range(len(ends)), np.roll(range(len(ends)), -1), strict=True):
        edge = ends[second] - ends[first]
        along = (at - ends[first]) @ edge / (edge @ edge)
        on_edge = np.linalg.norm(at - ends[first] - along[:, None] * edge, axis=1) < 1e-9
        low, high = np.sort(faces[:, [first, second]], axis=1).T[..., None]
        step = np.rint(along[on_edge] * divisions).astype(np.int64)
        step = np.where(faces[:, [first]] == low, step, divisions - step)
        one, other = np.where(step == divisions, high, low), np.where(step == 0, low, high)
        number[:, on_edge] = (one * (faces.max() + 1) + other) * divisions + step % divisions
    return number.ravel()


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
