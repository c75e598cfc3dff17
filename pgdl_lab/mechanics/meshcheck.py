"""What a mesh of the user's must keep before anything is computed on it; one sentence for each fault."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]

# Neighbours of each corner in the order of VTK, such that the edges to them are right-handed.
NEIGHBOURS = {
    4: [(1, 2, 3), (2, 0, 3), (0, 1, 3), (0, 2, 1)],
    8: [(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)],
}
FLAT = 1e-6  # of the cube of the longest edge: corners below this span no volume


def place(point: Array) -> str:
    """Coordinates of a point (3,) [mm] for a message."""
    return f"({', '.join(f'{value:.4g}' for value in point)}) mm"


def require_right_handed(points: Array, elements: NDArray[np.int64], path: str) -> None:
    """Check that no element (E, 4) or (E, 8), in the order of VTK, is inverted or flat at a corner.

    Raises
    ------
    InputError
        Otherwise.
    """
    corner = np.arange(elements.shape[1])
    around = np.array(NEIGHBOURS[elements.shape[1]])
    edges = points[elements[:, around]] - points[elements[:, corner]][:, :, None]  # (E, corners, 3, xyz)
    longest = np.linalg.norm(edges, axis=3).max(axis=(1, 2))
    wrong = np.flatnonzero((np.linalg.det(edges) < FLAT * longest[:, None] ** 3).any(axis=1))
    if wrong.size:
        raise InputError(
            f"{wrong.size} of {len(elements)} elements of {path} are inverted or flat, the first near "
            f"{place(points[elements[wrong[0]]].mean(axis=0))}: mesh again, or reverse the order of their nodes."
        )


def require_connected(mesh: "Mesh", path: str) -> None:
    """Check that all elements hang together through common facets.

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
            f"{place(mesh.p[:, mesh.t[:, small]].mean(axis=1))}: merge nodes that coincide, or leave the rest out."
        )


def require_closed(mesh: "Mesh", path: str, symmetry: str) -> None:
    """Check that the walls of the cavities enclose air: they end only at the clamp or in the plane y = 0.

    `mesh` has its named boundaries; `symmetry` is the name that the user gave that of the plane.

    Raises
    ------
    InputError
        Otherwise.
    """
    walls = mesh.facets[:, mesh.boundaries["cavity"]]
    sides, count = np.unique(np.sort(_sides(walls), axis=1), axis=0, return_counts=True)
    rim = sides[count == 1]
    held = [set(np.unique(mesh.facets[:, mesh.boundaries[name]])) for name in ("clamp", "symmetry") if _has(mesh, name)]
    open_ = [side for side in rim.tolist() if not any(nodes.issuperset(side) for nodes in held)]
    if open_:
        hint = "" if _has(mesh, "symmetry") else f", or of the plane of symmetry, which needs a group '{symmetry}'"
        raise InputError(
            f"The cavity of {path} is open along {len(open_)} edges, the first near "
            f"{place(mesh.p[:, open_[0]].mean(axis=1))}: its group must hold all walls, up to the clamp{hint}."
        )
    if enclosed_mm3(mesh) <= 0:
        raise InputError(
            f"The cavity of {path} encloses no air: its group must hold the inner walls, not the outer surface."
        )


def enclosed_mm3(mesh: "Mesh") -> float:
    """Volume [mm³] behind the walls of the cavities, which may end in planes through the origin."""
    facets = mesh.boundaries["cavity"]
    corners = mesh.p[:, mesh.facets[:, facets]].transpose(2, 1, 0)
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T
    area = outward(corners, inside)
    return float(-np.einsum("fi,fi->", corners.mean(axis=1), area) / 3)


def outward(corners: Array, inside: Array) -> Array:
    """Area vectors (F, 3) of facets with `corners` (F, 3 or 4, 3) going round; they point away from `inside` (F, 3)."""
    across = corners[:, 2] - corners[:, 0]
    other = corners[:, 1] - corners[:, 0] if corners.shape[1] == 3 else corners[:, 1] - corners[:, 3]
    area = np.cross(across, other) / 2
    sign = np.sign(np.einsum("fi,fi->f", area, corners.mean(axis=1) - inside))
    return area * sign[:, None]


def _sides(facets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Edges (4 F or 3 F, 2) of facets (3 or 4, F) whose corners go round."""
    return np.stack([facets, np.roll(facets, -1, axis=0)], axis=-1).reshape(-1, 2)


def _has(mesh: "Mesh", name: str) -> bool:
    return name in mesh.boundaries
