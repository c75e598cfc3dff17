"""The side face of a finger: the points at which a simulation is observed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.profile import Profile, Region


@dataclass(frozen=True)
class Face:
    """Points on the outer side wall of the undeformed finger.

    Attributes
    ----------
    domain
        The triangulated face with the base line z = 0 and the clamped end x = 0.
    y_mm
        The plane y = const in which the face lies, or (N,) the y of each point [mm].
    """

    domain: Domain
    y_mm: float | NDArray[np.float64]


def nodes(profile: Profile) -> NDArray[np.bool_]:
    """Which grid nodes (nx + 1, nz + 1) of `profile` touch the face; the side walls close the cavities."""
    covered = np.pad(profile.regions != Region.GAP, 1)
    return covered[1:, 1:] | covered[1:, :-1] | covered[:-1, 1:] | covered[:-1, :-1]


def observe(profile: Profile, count: int, y_mm: float) -> Face:
    """Spread exactly `count` points evenly over the face of `profile`, its outline included.

    The points are the nodes of the coarsest conforming grid that has enough of them; the surplus is taken from the
    inside, evenly, so that the outline stays sharp.

    Raises
    ------
    InputError
        When `count` does not suffice to draw the outline.
    """
    fewest = int(nodes(profile).sum())
    if count < fewest:
        raise InputError(
            f"observation.points is {count}, but the outline of this finger alone needs {fewest}; "
            "ask for at least that many."
        )
    lower = upper = float(profile.x[-1] - profile.x[0])
    while nodes(profile.refined(lower, 0)).sum() < count:
        lower /= 2
    while upper - lower > 1e-6 * upper:  # an edge `lower` gives enough points, `upper` too few
        middle = (lower * upper) ** 0.5
        if nodes(profile.refined(middle, 0)).sum() >= count:
            lower = middle
        else:
            upper = middle
    grid = profile.refined(lower, 0)
    kept = nodes(grid)
    covered = np.pad(grid.regions != Region.GAP, 1)
    inside = covered[1:, 1:] & covered[1:, :-1] & covered[:-1, 1:] & covered[:-1, :-1]
    surplus = int(kept.sum()) - count
    interior = np.flatnonzero(inside)
    kept.ravel()[interior[np.linspace(0, interior.size, surplus, endpoint=False).astype(int)]] = False

    i, k = np.nonzero(kept)
    points = np.column_stack([grid.x[i], grid.z[k]])
    base, clamp = np.flatnonzero(k == 0), np.flatnonzero(i == 0)
    base = base[np.argsort(points[base, 0])]
    return Face(Domain(points, triangulate(points, profile), base=base, clamp=clamp), y_mm)


def triangulate(points: NDArray[np.float64], profile: Profile) -> NDArray[np.int64]:
    """Delaunay triangles (T, 3) of `points` (N, 2) [mm] that lie on the face, not in a gap."""
    from scipy.spatial import Delaunay

    triangles = Delaunay(points).simplices
    corners = points[triangles]
    legs = corners[:, 1:] - corners[:, :1]
    area = np.abs(legs[:, 0, 0] * legs[:, 1, 1] - legs[:, 0, 1] * legs[:, 1, 0]) / 2
    centre = corners.mean(axis=1)
    on_face = (profile.region(centre[:, 0], centre[:, 1]) != Region.GAP) & (area > 1e-9 * area.max())
    return triangles[on_face].astype(np.int64)
