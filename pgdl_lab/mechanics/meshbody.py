"""From a mesh file to the body of a finger: placed, with its named boundaries, and checked."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.meshcheck import require_closed, require_connected, require_right_handed
from pgdl_lab.mechanics.meshfile import BEND, MeshFile, read, to_skfem

if TYPE_CHECKING:
    from skfem import Mesh

_log = logging.getLogger(__name__)

IN_PLANE = 1e-6  # of the largest side of the body


def load(path: Path, unit: str, clamp: str, cavity: str, symmetry: str) -> "Mesh":
    """Read a finger and place it as all fingers lie.

    Its clamp begins at x = 0, its lowest point lies at z = 0, and its plane of symmetry, or else the middle of its
    width, is y = 0.

    Parameters
    ----------
    path
        The file.
    unit
        Its unit of length, one of `pgdl_lab.mechanics.meshfile.MM`.
    clamp, cavity, symmetry
        Names of its groups; without a group `symmetry` it holds the whole finger.

    Returns
    -------
    skfem.Mesh
        MeshTet or MeshHex with straight edges and the named boundaries `clamp`, `cavity` and, for half a finger,
        `symmetry` [mm].

    Raises
    ------
    InputError
        When the file, its mesh or its groups are no finger; the message says what to change.
    """
    file = read(path, unit)
    require_right_handed(file.points, file.elements, str(path))
    if file.bend > BEND:
        _log.warning(
            "Middle nodes of %s lie off their edges by up to %.2g of an edge: the edges are taken as straight, so "
            "refine curved surfaces.",
            path,
            file.bend,
        )
    mesh = to_skfem(file)
    require_connected(mesh, str(path))
    boundaries: dict[str, NDArray[np.int64]] = {}
    for field, name in (("symmetry", symmetry), ("clamp", clamp), ("cavity", cavity)):
        if field != "symmetry" or name in file.groups:
            boundaries[field] = _facets(mesh, file, name, field, path, boundaries)
    mesh = mesh.with_boundaries(boundaries)
    mesh = mesh.translated(-_origin(mesh, path))
    require_closed(mesh, str(path), symmetry)
    return mesh


def _facets(
    mesh: "Mesh", file: MeshFile, name: str, field: str, path: Path, taken: dict[str, NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Boundary facets of `mesh` in the group `name`, none of which is in those that are `taken`."""
    group = file.group(name)
    if group is None:
        raise InputError(
            f"{path} has no group '{name}' of facets or nodes for finger.{field}; "
            f"its groups are {', '.join(file.groups) or 'none'}."
        )
    surface = mesh.boundary_facets()
    corners = mesh.facets[:, surface]
    if group.dtype == bool:
        # Of nodes: a facet belongs to them with all its corners. Those of a rim belong to two groups, and on a coarse
        # mesh a facet may have all its corners on it.
        found = np.setdiff1d(surface[group[corners].all(axis=0)], np.concatenate([*taken.values(), []]))
    else:
        number = dict(zip(map(tuple, np.sort(corners.T, axis=1).tolist()), surface, strict=True))
        numbers = [number.get(facet, -1) for facet in map(tuple, np.sort(group, axis=1).tolist())]
        found = np.unique(numbers)
        if found[0] < 0:
            raise InputError(
                f"{numbers.count(-1)} of {len(numbers)} facets of the group '{name}' in {path} are not on the surface "
                "of the volume mesh: name surfaces of the solid only."
            )
    if not found.size:
        raise InputError(f"The group '{name}' in {path} holds no whole facet of the surface: name its facets.")
    for other, facets in taken.items():
        if shared := np.intersect1d(facets, found).size:
            raise InputError(
                f"{shared} facets of {path} are in both the groups for finger.{other} and finger.{field}: "
                "a facet can be in one."
            )
    return found.astype(np.int64)


def _origin(mesh: "Mesh", path: Path) -> NDArray[np.float64]:
    """The point of the file (3,) that becomes the origin [mm]."""
    size = np.ptp(mesh.p, axis=1).max()
    middle = (mesh.p[1].min() + mesh.p[1].max()) / 2
    if "symmetry" in mesh.boundaries:
        y = mesh.p[1, mesh.facets[:, mesh.boundaries["symmetry"]]]
        if np.ptp(y) > IN_PLANE * size or y.max() > mesh.p[1].min() + IN_PLANE * size:
            raise InputError(
                f"The symmetry group of {path} spans y = {y.min():.4g} to {y.max():.4g} mm and the body "
                f"{mesh.p[1].min():.4g} to {mesh.p[1].max():.4g} mm: it must be the plane of smallest y."
            )
        middle = y.min()
    x = mesh.p[0, mesh.facets[:, mesh.boundaries["clamp"]]]
    return np.array([x.min(), middle, mesh.p[2].min()])
