"""The observed side face of a finger that comes as a mesh: the outermost of what looks to +y, at each x."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.meshcavity import outward

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FACING = 0.7  # y of the unit normal from which on a facet looks to the side
NEAR = 1e-6  # of the largest side of the body
STRAIGHT = 1e-6  # sine of the angle between edges that count as one
INWARD = 1e-10  # of the way to the middle of the element behind: points lie in it also by round-off
NUDGE = 1e-6  # of that way: a point on an edge is then inside its own facet, and in no other
STATIONS = 200  # along x, at which it is looked for what is outermost
REACH = 0.1  # of the length: how far from the clamp and from the tip the face may end
CLEAR = 0.6  # of the spacing: how far inner points keep from the outline


@dataclass(frozen=True)
class Side:
    """The facets of the side face as triangles, and its outline.

    Attributes
    ----------
    corners
        (T, 3, 3) corners x, y, z of the triangles [mm].
    inside
        (T, 3) middle of the element behind each [mm].
    piece
        (T,) which of the connected pieces of the face each belongs to; one may hide a part of another.
    outline
        (S, 2) numbers of the nodes at the ends of the edges that belong to one facet only.
    behind
        (S, 3) middle of the element behind each of these [mm].
    nodes
        (N, 3) nodes of the mesh [mm].
    clamped
        (S,) bool, whether the edge belongs to the clamp as well.
    """

    corners: Array
    inside: Array
    piece: Index
    outline: Index
    behind: Array
    nodes: Array
    clamped: NDArray[np.bool_]


@dataclass(frozen=True)
class Samples:
    """Points on the side face: where they are, the middle of the element behind, and whether they are clamped."""

    points: Array
    behind: Array
    clamped: NDArray[np.bool_]


def observe_side(mesh: "Mesh", count: int) -> Face:
    """Spread exactly `count` points evenly over the side face of `mesh` [mm], its outline included.

    The side face is the part of the surface in which the outward normal points mostly to +y, with all of its connected
    pieces that are outermost somewhere along x; the clamp, the cavities and the plane of symmetry are no part of it.
    Its base line is what is lowest at each x.

    Raises
    ------
    InputError
        When `count` does not suffice to draw the outline, or the face does not reach from the clamp to the tip.
    """
    side = find(mesh)
    require_span(mesh, side)
    chains = straight_chains(side)
    fewest = len(along(side, chains, np.inf).points)
    if count < fewest:
        raise InputError(
            f"observation.points is {count}, but the outline of this finger alone needs {fewest}; "
            "ask for at least that many."
        )
    lower = upper = float(np.ptp(side.corners[..., 0]))
    while len(spread(side, chains, lower).points) < count:
        lower /= 2
    for _ in range(20):  # a spacing `lower` gives enough points, `upper` too few
        middle = (lower * upper) ** 0.5
        if len(spread(side, chains, middle).points) >= count:
            lower = middle
        else:
            upper = middle
    edge = len(along(side, chains, lower).points)
    samples = spread(side, chains, lower)
    kept = np.ones(len(samples.points), dtype=bool)
    surplus = len(kept) - count
    kept[edge + np.linspace(0, len(kept) - edge, surplus, endpoint=False).astype(int)] = False
    place = samples.points[kept] + INWARD * (samples.behind[kept] - samples.points[kept])
    points = place[:, [0, 2]]
    base = lowest(side, samples.points[:edge])
    base, clamp = base[np.argsort(points[base, 0])], np.flatnonzero(samples.clamped[kept])
    return Face(Domain(points, triangulate(side, points), base=base, clamp=clamp), place[:, 1])


def find(mesh: "Mesh") -> Side:
    """The side face of `mesh`.

    Raises
    ------
    InputError
        When nothing looks to the side where y is largest.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    facets = np.setdiff1d(mesh.boundary_facets(), np.concatenate(list(mesh.boundaries.values())))
    corners = mesh.p[:, mesh.facets[:, facets]].transpose(2, 1, 0)
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T
    area = outward(corners, inside)
    looks = area[:, 1] > FACING * np.linalg.norm(area, axis=1)
    facets, corners, inside = facets[looks], corners[looks], inside[looks]
    if not len(facets):
        raise InputError(
            "No facet of the mesh that is neither clamp, cavity nor symmetry looks to +y: there is no side face to "
            "observe; let x run from the clamp to the tip, z up and y to the side."
        )

    going_round = mesh.facets[:, facets].T
    edges = np.stack([going_round, np.roll(going_round, -1, axis=1)], axis=-1)  # (F, 3 or 4, 2)
    flat = np.sort(edges.reshape(-1, 2), axis=1)
    _, number, uses = np.unique(flat, axis=0, return_inverse=True, return_counts=True)
    owner = np.repeat(np.arange(len(facets)), edges.shape[1])
    member = coo_matrix((np.ones(len(owner)), (owner, number.ravel())), shape=(len(facets), len(uses))).tocsr()
    _, piece = connected_components(member @ member.T, directed=False)
    surface = mesh.p[:, mesh.facets[:, mesh.boundary_facets()]].transpose(2, 1, 0)
    kept = np.isin(piece, outermost(corners, surface, piece, NEAR * float(np.ptp(mesh.p, axis=1).max())))
    once = (uses[number.ravel()] == 1) & kept[owner]

    held = np.sort(_edges_of(mesh.facets[:, mesh.boundaries["clamp"]]), axis=1)
    known = {tuple(edge) for edge in held.tolist()}
    outline = flat[once]
    rows = [[0, 1, 2]] if corners.shape[1] == 3 else [[0, 1, 2], [0, 2, 3]]
    return Side(
        corners=np.concatenate([corners[kept][:, row] for row in rows]),
        inside=np.concatenate([inside[kept]] * len(rows)),
        piece=np.concatenate([piece[kept]] * len(rows)),
        outline=outline,
        behind=inside[owner[once]],
        nodes=mesh.p.T,
        clamped=np.array([tuple(edge) in known for edge in outline.tolist()]),
    )


def outermost(corners: Array, surface: Array, piece: Index, near_mm: float) -> Index:
    """Which pieces are the outermost of a whole `surface` along y at some x.

    Parameters
    ----------
    corners
        (F, 3 or 4, 3) corners of the facets of all pieces [mm].
    surface
        (S, 3 or 4, 3) corners of all facets of the surface, whichever way they look [mm].
    piece
        (F,) the piece of each facet.
    near_mm
        What is so near to the outermost counts too: one face may have a groove along it [mm].
    """
    found: set[int] = set()
    low, high = (float(limit) for limit in (corners[..., 0].min(), corners[..., 0].max()))
    for station in low + (np.arange(STATIONS) + 0.5) / STATIONS * (high - low):
        owner, y = _section(corners, station)
        _, whole = _section(surface, station)
        if len(whole):
            found |= set(piece[owner[y >= whole.max() - near_mm]].tolist())
    return np.array(sorted(found), dtype=np.int64)


def _section(corners: Array, x_mm: float) -> tuple[Index, Array]:
    """Where edges of facets (F, 3 or 4, 3) cross a plane x = const: the facet of each edge, and its y there [mm]."""
    one, other = corners, np.roll(corners, -1, axis=1)
    facet, corner = np.nonzero((one[..., 0] < x_mm) != (other[..., 0] < x_mm))
    start, end = one[facet, corner], other[facet, corner]
    part = (x_mm - start[:, 0]) / (end[:, 0] - start[:, 0])
    return facet, start[:, 1] + part * (end[:, 1] - start[:, 1])


def require_span(mesh: "Mesh", side: Side) -> None:
    """Check that the side face reaches from the clamp to the tip.

    Raises
    ------
    InputError
        Otherwise.
    """
    x, held = mesh.p[0], mesh.p[0, mesh.facets[:, mesh.boundaries["clamp"]]]
    first, last = float(side.corners[..., 0].min()), float(side.corners[..., 0].max())
    reach = REACH * float(np.ptp(x))
    if first > held.max() + reach or last < x.max() - reach or not side.clamped.any():
        touches = "" if side.clamped.any() else ", and does not touch the clamp"
        raise InputError(
            f"The side face, the outermost of what looks to +y, spans x = {first:.4g} to {last:.4g} mm{touches}, but "
            f"the body {x.min():.4g} to {x.max():.4g} mm: give the finger a side from the clamp to the tip, and let x "
            "run that way, z up and y to the side (finger.axes)."
        )


def _edges_of(facets: Index) -> Index:
    return np.stack([facets, np.roll(facets, -1, axis=0)], axis=-1).reshape(-1, 2)


def straight_chains(side: Side) -> list[tuple[Index, Index]]:
    """Cut the outline at its corners: for each straight piece its nodes in a row, and the edges between them."""
    at: dict[int, list[int]] = {}
    for edge, ends in enumerate(side.outline.tolist()):
        for node in ends:
            at.setdefault(node, []).append(edge)

    def other(edge: int, node: int) -> int:
        first, second = side.outline[edge].tolist()
        return second if node == first else first

    def goes_on(node: int) -> bool:
        if len(at[node]) != 2:
            return False
        one, two = (side.nodes[other(edge, node)] - side.nodes[node] for edge in at[node])
        sine = np.linalg.norm(np.cross(one, two)) / (np.linalg.norm(one) * np.linalg.norm(two))
        same_kind = side.clamped[at[node][0]] == side.clamped[at[node][1]]
        return bool(sine < STRAIGHT and same_kind)

    chains = []
    for start in (node for node in at if not goes_on(node)):
        for edge in at[start]:
            nodes, edges = [start], []
            while True:
                nodes.append(other(edge, nodes[-1]))
                edges.append(edge)
                if not goes_on(nodes[-1]):
                    break
                edge = next(candidate for candidate in at[nodes[-1]] if candidate != edge)
            if nodes[0] < nodes[-1]:  # each is met from both ends
                chains.append((np.array(nodes), np.array(edges)))
    return chains


def along(side: Side, chains: list[tuple[Index, Index]], spacing_mm: float) -> Samples:
    """Points of the outline at most `spacing_mm` [mm] apart, its corners included once."""
    points, behind, clamped = [], [], []
    corners: dict[int, tuple[int, bool]] = {}
    for nodes, edges in chains:
        place = side.nodes[nodes]
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])
        at = np.linspace(0, arc[-1], max(1, int(np.ceil(arc[-1] / spacing_mm - 1e-9))) + 1)[1:-1]
        edge = edges[np.clip(np.searchsorted(arc, at, side="right") - 1, 0, len(edges) - 1)]
        points.append(np.column_stack([np.interp(at, arc, place[:, i]) for i in range(3)]))
        behind.append(side.behind[edge])
        clamped.append(side.clamped[edge])
        for node, end in ((nodes[0], edges[0]), (nodes[-1], edges[-1])):
            held = corners[node][1] if node in corners else False
            corners[int(node)] = (int(end), bool(held or side.clamped[end]))
    points.append(side.nodes[list(corners)])
    behind.append(side.behind[[end for end, _ in corners.values()]])
    clamped.append(np.array([held for _, held in corners.values()]))
    return in_sight(side, Samples(np.concatenate(points), np.concatenate(behind), np.concatenate(clamped)))


def in_sight(side: Side, outline: Samples) -> Samples:
    """The points of the outline that no other piece of the face hides; of two at one place the outer one."""
    from scipy.spatial import cKDTree

    if (side.piece == side.piece[0]).all():
        return outline
    near = NEAR * float(np.ptp(side.corners[..., 0]))
    nudged = outline.points + NUDGE * (outline.behind - outline.points)
    triangle = locate(side, nudged[:, [0, 2]])
    hidden = triangle >= 0
    hidden[hidden] = height(side, triangle[hidden], nudged[hidden][:, [0, 2]]) > outline.points[hidden, 1] + near
    for one, other in cKDTree(outline.points[:, [0, 2]]).query_pairs(near, output_type="ndarray"):
        hidden[one if outline.points[one, 1] < outline.points[other, 1] else other] = True
    return Samples(outline.points[~hidden], outline.behind[~hidden], outline.clamped[~hidden])


def spread(side: Side, chains: list[tuple[Index, Index]], spacing_mm: float) -> Samples:
    """Points of the outline, then points inside, evenly `spacing_mm` [mm] apart."""
    from scipy.spatial import cKDTree

    outline = along(side, chains, spacing_mm)
    low, high = side.corners.min(axis=(0, 1)), side.corners.max(axis=(0, 1))
    steps = np.ceil((high - low) / spacing_mm - 1e-9).astype(int)
    x, z = (np.linspace(low[i], high[i], steps[i] + 1)[1:-1] for i in (0, 2))
    grid = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    triangle = locate(side, grid)
    near, _ = cKDTree(outline.points[:, [0, 2]]).query(grid)
    kept = (triangle >= 0) & (near > CLEAR * spacing_mm)
    grid, triangle = grid[kept], triangle[kept]
    y = height(side, triangle, grid)
    return Samples(
        np.concatenate([outline.points, np.column_stack([grid[:, 0], y, grid[:, 1]])]),
        np.concatenate([outline.behind, side.inside[triangle]]),
        np.concatenate([outline.clamped, np.zeros(len(grid), dtype=bool)]),
    )


def locate(side: Side, points: Array) -> Index:
    """Outermost triangle of the side face that covers each of `points` (N, 2) [mm], −1 where there is none."""
    from matplotlib.tri import Triangulation

    covering, outer = np.full(len(points), -1), np.full(len(points), -np.inf)
    for piece in np.unique(side.piece):
        triangles = np.flatnonzero(side.piece == piece)
        corners = side.corners[triangles][..., [0, 2]].reshape(-1, 2)
        unique, number = np.unique(corners, axis=0, return_inverse=True)
        finder = Triangulation(unique[:, 0], unique[:, 1], number.reshape(-1, 3)).get_trifinder()
        found = np.asarray(finder(points[:, 0], points[:, 1]), dtype=np.int64)
        covers = np.flatnonzero(found >= 0)
        triangle = triangles[found[covers]]
        y = height(side, triangle, points[covers])
        farther = y > outer[covers]
        covering[covers[farther]], outer[covers[farther]] = triangle[farther], y[farther]
    return covering


def height(side: Side, triangle: Index, points: Array) -> Array:
    """The y (N,) [mm] of a triangle of the side face at each of `points` (N, 2) x and z [mm]."""
    a, b, c = side.corners[triangle].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    result: Array = a[:, 1] - ((points - a[:, [0, 2]]) * normal[:, [0, 2]]).sum(axis=1) / normal[:, 1]
    return result


def lowest(side: Side, points: Array) -> Index:
    """Which of `points` (N, 3) of the outline have nothing of it below them."""
    ends = side.nodes[side.outline][..., [0, 2]]  # (S, 2, xz)
    (x0, z0), (x1, z1) = ends[:, 0].T, ends[:, 1].T
    near = NEAR * np.ptp(side.corners[..., 0])
    x, z = points[:, [0]], points[:, 2]
    upright = np.abs(x1 - x0) <= near
    part = np.clip((x - x0) / np.where(upright, 1, x1 - x0), 0, 1)
    height = np.where(upright, np.minimum(z0, z1), z0 + part * (z1 - z0))
    spans = (x >= np.minimum(x0, x1) - near) & (x <= np.maximum(x0, x1) + near)
    below = np.where(spans, height, np.inf).min(axis=1)
    return np.flatnonzero(z <= below + near)


def triangulate(side: Side, points: Array) -> Index:
    """Delaunay triangles (T, 3) of `points` (N, 2) [mm] that lie on the face."""
    from scipy.spatial import Delaunay

    triangles = Delaunay(points).simplices
    corners = points[triangles]
    legs = corners[:, 1:] - corners[:, :1]
    area = np.abs(legs[:, 0, 0] * legs[:, 1, 1] - legs[:, 0, 1] * legs[:, 1, 0]) / 2
    on_face = (locate(side, corners.mean(axis=1)) >= 0) & (area > 1e-6 * area.max())
    found: Index = triangles[on_face].astype(np.int64)
    return found
