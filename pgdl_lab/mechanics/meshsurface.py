"""A part of a body's surface, picked by a surface file (STL) that it lies on."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.rawmesh import read_raw

Array = NDArray[np.float64]

SUFFIXES = (".stl", ".obj", ".ply", ".off")
NEAR = 0.1  # of the mean edge of the body's surface: nodes on two meshes of one curved surface differ by less


def is_surface(text: str) -> bool:
    """Whether `text` names a file of a surface."""
    return Path(text).suffix.lower() in SUFFIXES


def triangles(path: Path) -> Array:
    """Triangles (T, 3, 3) of a surface file, in its own unit and axes.

    Raises
    ------
    InputError
        When there is no such file, or when it holds no triangles.
    """
    raw = read_raw(path).mesh
    corners = [block.data for block in raw.cells if block.type == "triangle"]
    if not corners:
        raise InputError(f"{path} has no triangles: save the walls of the cavity as a triangulated surface (.stl).")
    return np.asarray(raw.points, dtype=np.float64)[np.concatenate(corners)]


def distances(points: Array, surface: Array, farthest: float) -> Array:
    """Distance (N,) of `points` (N, 3) from the triangles of `surface` (T, 3, 3); infinite beyond `farthest`."""
    found = np.full(len(points), np.inf)
    order = np.argsort(points[:, 0], kind="stable")
    sorted_x = points[order, 0]
    low, high = surface.min(axis=1) - farthest, surface.max(axis=1) + farthest
    first, last = np.searchsorted(sorted_x, low[:, 0]), np.searchsorted(sorted_x, high[:, 0], side="right")
    for triangle, lower, upper, start, stop in zip(surface, low, high, first, last, strict=True):
        close = order[start:stop]
        close = close[((points[close] >= lower) & (points[close] <= upper)).all(axis=1)]
        if len(close):
            found[close] = np.minimum(found[close], _distance(points[close], triangle))
    found[found > farthest] = np.inf
    return found


def _distance(points: Array, triangle: Array) -> Array:
    """Distance (N,) of `points` (N, 3) from a triangle (3, 3)."""
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    size = np.linalg.norm(normal)
    nearest = np.full(len(points), np.inf)
    inside = np.full(len(points), size > 0)
    for one, other in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        edge, from_one = other - one, points - one
        part = np.clip(from_one @ edge / max(float(edge @ edge), 1e-300), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(from_one - part[:, None] * edge, axis=1))
        inside &= np.cross(edge, from_one) @ normal >= 0
    above = np.abs((points - triangle[0]) @ normal) / max(float(size), 1e-300)
    return np.where(inside, above, nearest)
