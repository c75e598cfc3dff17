"""From a mesh file to the body of a finger: placed, with its named boundaries, and checked."""

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.meshaxes import named, rotation
from pgdl_lab.mechanics.meshcavity import inner_surfaces, require_closed
from pgdl_lab.mechanics.meshcheck import require_connected, require_uncrossed
from pgdl_lab.mechanics.meshfile import BEND, USUAL_MM, read, to_skfem
from pgdl_lab.mechanics.meshparts import IN_PLANE, WHOLE, Parts, Surface, unnamed
from pgdl_lab.mechanics.meshplace import require_laid, sides

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
    if "symmetry" not in mesh.boundaries:
        _require_no_mirror(turned, name)
    origin = _origin(mesh, path)
    require_closed(mesh, name, turned, parts.symmetry)
    if "symmetry" not in mesh.boundaries:
        plane = None if parts.symmetry == WHOLE else surface.in_plane_of_least_y(parts)
        doubts += filter(None, [sides(mesh, name, turned, plane)])
    return MeshBody(mesh.translated(-origin), tuple(doubts))


def _require_no_mirror(axes: NDArray[np.float64], path: str) -> None:
    """Check that a whole finger is turned, not mirrored; half a finger stands for a whole that its mirror image is too.

    Raises
    ------
    InputError
        Otherwise.
    """
    if np.linalg.det(axes) < 0:
        raise InputError(
            f"finger.axes={named(axes)} makes a mirror image of {path}: turn it instead, e.g. by "
            f"finger.axes={named(np.diag([1.0, -1.0, 1.0]) @ axes)}."
        )


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
