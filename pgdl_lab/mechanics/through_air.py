"""What could meet only through the body: the two sides of a thin wall, and neighbours on a surface of small faces."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.collision import collisions, each

if TYPE_CHECKING:
    import ipctk
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LOOKS = 1e-6  # cosine of the angle between its normal and a way that a triangle looks along
NO_WALL = 1e-3  # of the distance that is looked at: surfaces that are nearer touch, as at nodes that are not merged


def shut_out_body(mesh: "ipctk.CollisionMesh", farthest_mm: float) -> float:
    """The smallest distance through air on `mesh` at rest [mm]; infinite beyond `farthest_mm` [mm].

    If it is, pairs that are within `farthest_mm` of each other, but through the body or along its surface, never meet.
    Where surfaces cross at rest, all is air.
    """
    import ipctk
    from scipy.sparse import triu

    at, triangles = mesh.rest_positions, mesh.faces
    found = collisions(mesh, at, farthest_mm)
    if found.empty():
        return np.inf

    def stencil(pair: "ipctk.NormalCollision") -> tuple[list[int], Array, bool]:
        return (
            pair.vertex_ids(mesh.edges, triangles),
            pair.compute_coefficients(at, mesh.edges, triangles),
            isinstance(pair, ipctk.EdgeEdgeNormalCollision),
        )

    vertices, shares, edges = zip(*each(found, stencil), strict=True)
    vertex = np.array(vertices)
    share = np.zeros(vertex.shape)
    share[vertex >= 0] = np.concatenate(shares)
    first = np.arange(4) < np.where(edges, 2, 1)[:, None]
    way = np.einsum("pv,pvi->pi", share, at[vertex])  # from the second part of each pair to the first
    parts = [incidence(vertex, (share != 0) & part, len(at)) for part in (first, ~first)]
    around = incidence(triangles, np.ones(triangles.shape, dtype=bool), len(at))
    normals = np.cross(at[triangles[:, 1]] - at[triangles[:, 0]], at[triangles[:, 2]] - at[triangles[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    length = np.linalg.norm(way, axis=1)
    air = looks(parts[0], around, normals, -way) & looks(parts[1], around, normals, way)
    air |= length < NO_WALL * farthest_mm
    if air.any() or ipctk.has_intersections(mesh, at):
        return float(length[air].min(initial=farthest_mm))

    # Edges and triangles can meet if any vertex of one can meet any of the other: shut out are all around both.
    ring = around.T @ around
    near = parts[0].T @ parts[1]
    one, other = triu(ring @ (near + near.T) @ ring, 1).nonzero()
    filtered = dict.fromkeys(zip(one.tolist(), other.tolist(), strict=True), False)
    mesh.can_collide = ipctk.make_sparse_filter(filtered, True)
    return np.inf


def incidence(vertex: Index, which: NDArray[np.bool_], count: int) -> "csr_matrix":
    """Matrix (M, `count`) that is 1 where a row of `vertex` (M, A) holds a vertex that `which` (M, A) counts."""
    from scipy.sparse import csr_matrix

    row = np.nonzero(which)[0]
    return csr_matrix((np.ones(len(row)), (row, vertex[which])), shape=(len(vertex), count))


def looks(part: "csr_matrix", around: "csr_matrix", normals: Array, way: Array) -> NDArray[np.bool_]:
    """Whether a triangle at each part, a vertex, edge or triangle, looks along a `way` (P, 3).

    `part` (P, V) and `around` (T, V) say which vertices each part and each triangle has; `normals` are (T, 3).
    """
    common = (part @ around.T).tocoo()
    at_it = common.data == np.diff(part.indptr)[common.row]  # the triangle has all vertices of the part
    pair, triangle = common.row[at_it], common.col[at_it]
    along = np.einsum("ni,ni->n", normals[triangle], way[pair])
    result = np.zeros(len(way), dtype=bool)
    result[pair[along > LOOKS * np.linalg.norm(way[pair], axis=1)]] = True
    return result
