"""The observed side face of a finger that comes as a mesh: where it looks to +y."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.meshcheck import outward

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FACING = 0.7  # y of the unit normal from which on a facet looks to the side
NEAR = 1e-6  # of the largest side of the body
STRAIGHT = 1e-6  # sine of the angle between edges that count as one
INWARD = 1e-10  # of the way to the middle of the element behind: points lie in it also by round-off
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

    The side face is the part of the surface around the largest y in which the outward normal points mostly to +y; the
    clamp, the cavities and the plane of symmetry are no part of it. Its base line is what is lowest at each x.

    Raises
    ------
    InputError
        When `count` does not suffice to draw the outline, or the face does not reach the clamp.
    """
    side = find(mesh)
    if not side.clamped.any():
        raise InputError(
            "The side face (facets of largest y whose normal points to +y) does not reach the clamp: give the finger a "
            "side along its length, and let x run from the clamp to the tip, z up and y to the side."
        )
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
    return Face(
        points=points,
        triangles=triangulate(side, points),
        base=base[np.argsort(points[base, 0])],
        clamp=np.flatnonzero(samples.clamped[kept]),
        y_mm=place[:, 1],
    )


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

    going_round = mesh.facets[:, facets].T
    edges = np.stack([going_round, np.roll(going_round, -1, axis=1)], axis=-1)  # (F, 3 or 4, 2)
    flat = np.sort(edges.reshape(-1, 2), axis=1)
    _, number, uses = np.unique(flat, axis=0, return_inverse=True, return_counts=True)
    owner = np.repeat(np.arange(len(facets)), edges.shape[1])
    member = coo_matrix((np.ones(len(owner)), (owner, number.ravel())), shape=(len(facets), len(uses))).tocsr()
    _, piece = connected_components(member @ member.T, directed=False)
    size = np.ptp(mesh.p, axis=1).max()
    top = corners[:, :, 1].max(axis=1) > mesh.p[1].max() - NEAR * size
    if not top.any():
        raise InputError(
            "No facet of the mesh that is neither clamp, cavity nor symmetry looks to +y where y is largest: there is "
            "no side face to observe; let x run from the clamp to the tip, z up and y to the side."
        )
    kept = np.isin(piece, piece[top])
    once = (uses[number.ravel()] == 1) & kept[owner]

    held = np.sort(_edges_of(mesh.facets[:, mesh.boundaries["clamp"]]), axis=1)
    known = {tuple(edge) for edge in held.tolist()}
    outline = flat[once]
    rows = [[0, 1, 2]] if corners.shape[1] == 3 else [[0, 1, 2], [0, 2, 3]]
    return Side(
        corners=np.concatenate([corners[kept][:, row] for row in rows]),
        inside=np.concatenate([inside[kept]] * len(rows)),
        outline=outline,
        behind=inside[owner[once]],
        nodes=mesh.p.T,
        clamped=np.array([tuple(edge) in known for edge in outline.tolist()]),
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
    return Samples(np.concatenate(points), np.concatenate(behind), np.concatenate(clamped))


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
    a, b, c = side.corners[triangle].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    y = a[:, 1] - ((grid - a[:, [0, 2]]) * normal[:, [0, 2]]).sum(axis=1) / normal[:, 1]
    return Samples(
        np.concatenate([outline.points, np.column_stack([grid[:, 0], y, grid[:, 1]])]),
        np.concatenate([outline.behind, side.inside[triangle]]),
        np.concatenate([outline.clamped, np.zeros(len(grid), dtype=bool)]),
    )


def locate(side: Side, points: Array) -> Index:
    """Triangle of the side face that covers each of `points` (N, 2) [mm], −1 where there is none."""
    from matplotlib.tri import Triangulation

    corners = side.corners[..., [0, 2]].reshape(-1, 2)
    unique, number = np.unique(corners, axis=0, return_inverse=True)
    finder = Triangulation(unique[:, 0], unique[:, 1], number.reshape(-1, 3)).get_trifinder()
    return np.asarray(finder(points[:, 0], points[:, 1]), dtype=np.int64)


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
