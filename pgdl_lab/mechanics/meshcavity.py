"""The cavities of a user's mesh: what they enclose, and inner surfaces that nobody named."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.meshcheck import place

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Chamber:
    """Walls that hang together, and what they enclose.

    Attributes
    ----------
    facets
        (F,) facets of the mesh.
    volume_mm3
        Volume behind them, where the clamp and the plane of symmetry close their openings [mm³]; negative for an outer
        surface, whose inside is the solid.
    middle
        (3,) middle of the walls, along the axes of the lab and in the place that the body has in the file [mm].
    open_edges
        (R, 2) ends of the edges at which they end elsewhere: nothing closes them.
    """

    facets: Index
    volume_mm3: float
    middle: Array
    open_edges: Index

    def told(self, axes: Array) -> str:
        """Its size and place for a message, given the axes of the lab, (3, 3) in terms of the file's."""
        return f"{self.volume_mm3:.4g} mm³ around {place(self.middle @ axes)}"


def chambers(mesh: "Mesh", facets: Index) -> list[Chamber]:
    """Sort `facets` of the boundary of `mesh`, which has its other boundaries named, into pieces that hang together."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(facets):
        return []
    corners = _outward_corners(mesh, facets)
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    owner = np.repeat(np.arange(len(facets)), corners.shape[1])
    _, edge, uses = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True)
    edge = edge.ravel()
    member = coo_matrix((np.ones(len(edge)), (owner, edge)), shape=(len(facets), len(uses))).tocsr()
    member = member[:, uses == 2]  # where four meet, two chambers may touch
    count, piece = connected_components(member @ member.T, directed=False)
    clamped, mirrored = (_nodes_of(mesh, name) for name in ("clamp", "symmetry"))
    found = []
    for number in range(count):
        walls = piece == number
        rim = ends[(uses[edge] == 1) & walls[owner]]
        in_plane = np.isin(rim, mirrored).all(axis=1)
        held = np.isin(rim, clamped).all(axis=1) & ~in_plane
        found.append(
            Chamber(
                facets=facets[walls],
                volume_mm3=_enclosed(mesh.p.T, corners[walls], rim[held], mirrored),
                middle=mesh.p.T[corners[walls]].mean(axis=(0, 1)),
                open_edges=rim[~in_plane & ~held],
            )
        )
    return found


def _enclosed(points: Array, walls: Index, rim: Index, mirrored: Index) -> float:
    """Volume [mm³] in front of `walls` (F, 3 or 4), whose corners go round a normal out of the solid.

    By the divergence theorem a third of the sum of x · n A over a closed surface, with x from a point in the plane of
    symmetry: there x · n = 0, so that no cap is needed. Openings at the clamp, with the edges `rim` (R, 2), get a fan
    of triangles from one node of each; where such an opening reaches the plane of symmetry, from a node there, so that
    the side in the plane is part of the fan. Exact for openings that are each in one plane, wherever they lie.
    """
    origin = points[walls].mean(axis=(0, 1))
    if len(mirrored):
        origin[1] = points[mirrored, 1].mean()
    fans = np.concatenate([np.empty((0, 3), dtype=np.int64), *(_fan(loop, mirrored) for loop in _loops(rim))])
    total = 0.0
    for corners in (walls, fans):
        x = points[corners] - origin
        total += float(np.einsum("fi,fi->", x.mean(axis=1), _area(x)))
    return -total / 3


def _loops(rim: Index) -> list[Index]:
    """Edges (R, 2) sorted into those that hang together."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(rim):
        return []
    nodes, ends = np.unique(rim, return_inverse=True)
    first, second = ends.reshape(-1, 2).T
    links = coo_matrix((np.ones(len(rim)), (first, second)), shape=(len(nodes), len(nodes)))
    count, piece = connected_components(links, directed=False)
    return [rim[piece[first] == number] for number in range(count)]


def _fan(loop: Index, mirrored: Index) -> Index:
    """Triangles (R, 3) from one node of `loop` to its edges, the other way round than the walls beside them."""
    at_plane = np.intersect1d(loop, mirrored)
    hub = at_plane[0] if len(at_plane) else loop[0, 0]
    return np.column_stack([np.full(len(loop), hub), loop[:, 1], loop[:, 0]])


def require_closed(mesh: "Mesh", path: str, axes: Array, symmetry: str) -> None:
    """Check that the walls of the cavities enclose air: they end only at the clamp or in the plane of symmetry.

    Parameters
    ----------
    mesh
        The body with its named boundaries, in the place that it has in the file.
    axes
        (3, 3) the axes of the lab in terms of the file's.
    symmetry
        What the user calls the plane.

    Raises
    ------
    InputError
        Otherwise.
    """
    found = chambers(mesh, mesh.boundaries["cavity"])
    open_ = np.concatenate([chamber.open_edges for chamber in found])
    if len(open_):
        hint = (
            "" if "symmetry" in mesh.boundaries else f", or of the plane of symmetry, which needs a group '{symmetry}'"
        )
        raise InputError(
            f"The cavity of {path} is open along {len(open_)} edges, the first near "
            f"{place(mesh.p[:, open_[0]].mean(axis=1) @ axes)}: its group must hold all walls, up to the clamp{hint}."
        )
    for chamber in found:
        if chamber.volume_mm3 <= 0:
            raise InputError(
                f"The cavity of {path} encloses no air around {place(chamber.middle @ axes)}: its group must hold the "
                "inner walls, not the outer surface."
            )


def inner_surfaces(mesh: "Mesh") -> list[Chamber]:
    """Closed inner surfaces of `mesh` in none of its named boundaries, the largest first.

    Their openings, if any, lie at the clamp or in the plane of symmetry alone.
    """
    rest = np.setdiff1d(mesh.boundary_facets(), np.concatenate([*(mesh.boundaries or {}).values(), []]))
    found = [chamber for chamber in chambers(mesh, rest) if not len(chamber.open_edges) and chamber.volume_mm3 > 0]
    return sorted(found, key=lambda chamber: -chamber.volume_mm3)


def outward(corners: Array, inside: Array) -> Array:
    """Area vectors (F, 3) of facets with `corners` (F, 3 or 4, 3) going round; they point away from `inside` (F, 3)."""
    area = _area(corners)
    sign = np.sign(np.einsum("fi,fi->f", area, corners.mean(axis=1) - inside))
    return area * sign[:, None]


def _area(corners: Array) -> Array:
    """Area vectors (F, 3) of facets with `corners` (F, 3 or 4, 3) that go round them."""
    other = corners[:, 1] - corners[:, 0] if corners.shape[1] == 3 else corners[:, 1] - corners[:, 3]
    result: Array = np.cross(other, corners[:, 2] - corners[:, 0]) / 2
    return result


def _outward_corners(mesh: "Mesh", facets: Index) -> Index:
    """Corners (F, 3 or 4) of facets of the boundary, in the order that goes round their normal out of the solid."""
    corners = mesh.facets[:, facets].T.astype(np.int64)
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T
    x = mesh.p.T[corners]
    away = np.einsum("fi,fi->f", _area(x), x.mean(axis=1) - inside) > 0
    return np.where(away[:, None], corners, corners[:, ::-1])


def _nodes_of(mesh: "Mesh", name: str) -> Index:
    """Nodes on a named boundary; none if `mesh` has no such boundary."""
    return np.unique(mesh.facets[:, mesh.boundaries[name]]) if name in (mesh.boundaries or {}) else np.empty(0, int)
