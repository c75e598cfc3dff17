"""From a profile to hexahedra: the half finger, symmetric about y = 0, or the whole one."""

from typing import TYPE_CHECKING

import numpy as np

from pgdl_lab.mechanics.profile import Profile, Region, subdivide

if TYPE_CHECKING:
    from skfem import MeshHex


def extrude(
    profile: Profile,
    half_width_mm: float,
    side_wall_mm: float,
    edge_mm: float,
    *,
    halvings: int | None = None,
    whole: bool = False,
) -> "MeshHex":
    """Mesh the body 0 ≤ y ≤ `half_width_mm` [mm], or the `whole` |y| ≤ `half_width_mm`, with hexahedra.

    How long their edges are follows from `edge_mm` [mm] and the `halvings`, by default those of `profile`: see
    `pgdl_lab.mechanics.profile`. Cavities reach from the plane of symmetry to the side wall; gaps go through the whole
    width.

    Returns
    -------
    skfem.MeshHex
        With the named boundaries `clamp` (x = 0), `cavity` (all walls of the cavities) and, of half a body, `symmetry`
        (y = 0).
    """
    from skfem import MeshHex

    inner_mm = half_width_mm - side_wall_mm
    halvings = profile.halvings(edge_mm) if halvings is None else halvings
    grid = profile.refined(edge_mm, halvings)
    across = subdivide(np.array([0.0, inner_mm, half_width_mm]), edge_mm, halvings)
    if whole:
        across = np.concatenate([-across[:0:-1], across])
    block = MeshHex.init_tensor(grid.x, across, grid.z)
    x, y, z = block.p[:, block.t].mean(axis=1)
    region = profile.region(x, z)
    walled = np.abs(y) > inner_mm
    mesh = block.restrict(np.flatnonzero((region == Region.SOLID) | ((region == Region.CAVITY) & walled)))

    facets = mesh.boundary_facets()
    middle = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    owner = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1)
    x, y, z = middle + 1e-3 * (middle - owner)  # just beyond each facet, however thin the cavity and thick the element
    in_cavity = (profile.region(x, z) == Region.CAVITY) & (np.abs(y) < inner_mm) & (whole | (y > 0))
    boundaries = {"clamp": facets[np.isclose(middle[0], profile.x[0])], "cavity": facets[in_cavity]}
    if not whole:
        boundaries["symmetry"] = facets[np.isclose(middle[1], 0)]
    return mesh.with_boundaries(boundaries)
