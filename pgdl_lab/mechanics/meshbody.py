"""From a mesh file to the body of a finger: placed, with its named boundaries, and checked."""

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.meshaxes import rotation
from pgdl_lab.mechanics.meshcavity import inner_surfaces, require_closed
from pgdl_lab.mechanics.meshcheck import require_connected, require_uncrossed
from pgdl_lab.mechanics.meshfile import BEND, USUAL_MM, read, to_skfem
from pgdl_lab.mechanics.meshparts import WHOLE, Parts, Surface, unnamed
from pgdl_lab.mechanics.meshplace import require_laid, require_plane, require_turned, sides

if TYPE_CHECKING:
    from skfem import Mesh

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class MeshBody:
    """A checked finger from a file.

    Attributes
    ----------
    mesh
        MeshTet or MeshHex with straight edges and the named boundaries `clamp`, `cavity` and, for half a finger,
        `symmetry` [mm].
    doubts
        What may not be as meant, in sentences.
    """

    mesh: "Mesh"
    doubts: tuple[str, ...]


@lru_cache(maxsize=4)
def load(path: Path, unit: str, axes: tuple[str, ...], parts: Parts, stamps: tuple[int, ...]) -> MeshBody:
    """Read a finger and place it as all fingers lie.

    Its clamp begins at x = 0, its lowest point lies at z = 0, and its plane of symmetry, or else the middle of its
    width, is y = 0. The same files are read once.

    Parameters
    ----------
    path
        The file.
    unit
        Its unit of length, one of `pgdl_lab.mechanics.meshfile.MM`.
    axes
        The axes of the file that become x, y and z, see `pgdl_lab.mechanics.meshaxes.rotation`.
    parts
        What its user says of clamp, cavity and plane of symmetry.
    stamps
        When the files were changed last.

    Raises
    ------
    InputError
        When the file, its mesh or its parts are no finger; the message says what to change.
    """
    turned, name = rotation(axes), str(path)
    file = read(path, unit)
    for note in file.notes:
        _log.info(note)
    mesh = to_skfem(file, turned)
    require_connected(mesh, name, turned)
    require_uncrossed(mesh, name, turned)
    surface = Surface(mesh, file, path, unit, turned)
    boundaries, found = surface.boundaries(parts)
    mesh = mesh.with_boundaries(boundaries)
    if found:
        _log.info(
            "%s names no cavity: the air presses on its %d closed inner surface%s, %s.",
            *(path, len(found), "s" if len(found) > 1 else "", " and ".join(each.told(turned) for each in found)),
        )
    doubts = unnamed(inner_surfaces(mesh), path, turned)
    if file.bend > BEND:
        doubts.append(
            f"Middle nodes of {name} lie off their edges by up to {file.bend:.2g} of an edge: the edges are taken as "
            "straight, so refine curved surfaces."
        )
    if (size := float(np.ptp(mesh.p, axis=1).max())) < USUAL_MM:
        doubts.append(f"{name} is only {size:.3g} mm large: is its unit of length finger.unit={unit}?")
    require_laid(mesh, name, turned)
    if "symmetry" in mesh.boundaries:
        require_plane(mesh, name, turned)
        require_closed(mesh, name, turned, parts.symmetry)
    else:
        require_turned(name, turned)
        require_closed(mesh, name, turned, parts.symmetry)
        surely = parts.symmetry == WHOLE
        doubts += filter(None, [sides(mesh, name, turned, None if surely else surface.plane_of_least_y(parts), surely)])
    return MeshBody(mesh.translated(-_origin(mesh)), tuple(doubts))


def _origin(mesh: "Mesh") -> NDArray[np.float64]:
    """The point of the turned file (3,) that becomes the origin [mm]."""
    clamp, low, high = mesh.facets[:, mesh.boundaries["clamp"]], mesh.p.min(axis=1), mesh.p.max(axis=1)
    middle = low[1] if "symmetry" in mesh.boundaries else (low[1] + high[1]) / 2
    return np.array([mesh.p[0, clamp].min(), middle, low[2]])
