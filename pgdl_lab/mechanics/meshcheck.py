"""What the elements of a user's mesh must keep before anything is computed on them; one sentence for each fault."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
Elements = NDArray[np.int64]

# Neighbours of each corner in the order of VTK, such that the edges to them are right-handed.
NEIGHBOURS = {
    4: [(1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1)],
    8: [(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)],
}
OTHER_HAND = {4: [1, 0, 2, 3], 8: [4, 5, 6, 7, 0, 1, 2, 3]}
FACETS = {
    4: [(0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)],
    8: [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}
FLAT = 1e-6  # of the cube of the longest edge: corners below this span no volume
TOGETHER = 1e-5  # of the largest side of the body: nodes so near to each other are one
MERGE = "merge nodes that coincide in your mesher, or open a gap there"


def place(point: Array) -> str:
    """Coordinates of a point (3,) [mm] for a message."""
    return f"({', '.join(f'{value:.4g}' for value in point + 0.0)}) mm"


def without_copies(elements: Elements) -> Elements:
    """The elements (E, 4 or 8) without those whose corners another one has too."""
    _, first = np.unique(np.sort(elements, axis=1), axis=0, return_index=True)
    return elements[np.sort(first)]


def right_handed(points: Array, elements: Elements, path: str) -> tuple[Elements, bool]:
    """The elements (E, 4) or (E, 8) in the right-handed order of VTK, and whether all of them had to be reversed.

    Formats differ in the order of nodes, so that all elements of a file may seem inverted; some alone are a fault.

    Raises
    ------
    InputError
        When an element is inverted, unlike the most of them, or flat at a corner.
    """
    spans = _spans(points, elements)
    reverse = bool(np.median(spans) < 0)
    if reverse:
        elements = elements[:, OTHER_HAND[elements.shape[1]]]
        spans = _spans(points, elements)
    wrong = np.flatnonzero((spans < FLAT).any(axis=1))
    if wrong.size:
        raise InputError(
            f"{wrong.size} of {len(elements)} elements of {path} are inverted against the rest or flat, the first near "
            f"{place(points[elements[wrong[0]]].mean(axis=0))}: mesh again, or bring all nodes in one order."
        )
    return elements, reverse


def _spans(points: Array, elements: Elements) -> Array:
    """Volume (E, corners) that the edges at each corner span, over the cube of the longest edge of the element."""
    corner = np.arange(elements.shape[1])
    around = np.array(NEIGHBOURS[elements.shape[1]])
    edges = points[elements[:, around]] - points[elements[:, corner]][:, :, None]  # (E, corners, 3, xyz)
    longest = np.linalg.norm(edges, axis=3).max(axis=(1, 2)).clip(1e-300)
    result: Array = np.linalg.det(edges) / longest[:, None] ** 3
    return result


def require_sound(points: Array, elements: Elements, path: str) -> None:
    """Check that elements (E, 4 or 8) join at their nodes, two at a facet at most.

    Raises
    ------
    InputError
        When nodes coincide, or more than two elements share a facet.
    """
    from scipy.spatial import cKDTree

    near = TOGETHER * float(np.ptp(points, axis=0).max())
    pairs = cKDTree(points).query_pairs(near, output_type="ndarray")
    if len(pairs):
        raise InputError(
            f"{len(pairs)} nodes of {path} coincide with another one, the first near {place(points[pairs[0, 0]])}, so "
            f"that elements do not hang together there: {MERGE}."
        )
    sides = np.array(FACETS[elements.shape[1]])
    facets = np.sort(elements[:, sides].reshape(-1, sides.shape[1]), axis=1)
    unique, uses = np.unique(facets, axis=0, return_counts=True)
    if uses.max() > 2:
        raise InputError(
            f"{(uses > 2).sum()} facets of {path} belong to more than two elements, the first near "
            f"{place(points[unique[uses.argmax()]].mean(axis=0))}: elements overlap there, so mesh each volume once."
        )


def require_connected(mesh: "Mesh", path: str, axes: Array) -> None:
    """Check that all elements hang together through common facets.

    `axes` (3, 3) are those of the mesh in terms of the file's.

    Raises
    ------
    InputError
        Otherwise.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    one, other = mesh.f2t[:, mesh.f2t[1] >= 0]
    links = coo_matrix((np.ones(len(one)), (one, other)), shape=(mesh.nelements, mesh.nelements))
    pieces, piece = connected_components(links, directed=False)
    if pieces > 1:
        sizes = np.bincount(piece)
        small = np.flatnonzero(piece == sizes.argmin())[0]
        raise InputError(
            f"The elements of {path} form {pieces} pieces that share no facet, the smallest near "
            f"{place(mesh.p[:, mesh.t[:, small]].mean(axis=1) @ axes)}: make one conforming mesh of them, or leave the "
            "rest out."
        )


def require_uncrossed(mesh: "Mesh", path: str, axes: Array) -> None:
    """Check that the surface of the body at rest does not pass through itself.

    `axes` (3, 3) are those of the mesh in terms of the file's.

    Raises
    ------
    InputError
        Otherwise.
    """
    import ipctk

    corners = mesh.facets[:, mesh.boundary_facets()].T
    rows = [[0, 1, 2]] if corners.shape[1] == 3 else [[0, 1, 2], [0, 2, 3]]
    triangles = np.concatenate([corners[:, row] for row in rows])
    used, number = np.unique(triangles, return_inverse=True)
    points = np.asfortranarray(mesh.p.T[used])
    faces = number.reshape(-1, 3).astype(np.int32)
    edges = ipctk.edges(faces)
    if not ipctk.has_intersections(ipctk.CollisionMesh(points, edges, faces), points):
        return
    search = ipctk.HashGrid()
    search.build(points, edges, faces)
    for pair in search.detect_edge_face_candidates():
        edge, face = points[edges[pair.edge_id]], points[faces[pair.face_id]]
        if ipctk.is_edge_intersecting_triangle(*edge, *face):
            raise InputError(
                f"The surface of {path} passes through itself near {place(face.mean(axis=0) @ axes)} before anything "
                "acts on it: draw or mesh the parts there apart."
            )
    raise InputError(f"The surface of {path} passes through itself before anything acts on it: mesh its parts apart.")
