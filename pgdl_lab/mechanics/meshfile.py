"""A finger from a volume mesh file: elements, units and named groups."""

import contextlib
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError

if TYPE_CHECKING:
    import meshio
    from skfem import Mesh

Array = NDArray[np.float64]
Facets = NDArray[np.int64]

MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4}
"""Millimetres in each unit of length."""

CORNERS = {"tetra": 4, "tetra10": 4, "hexahedron": 8, "hexahedron20": 8, "hexahedron27": 8}
FACET_CORNERS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}
LESSER = ("vertex", "line", *FACET_CORNERS)  # cells without a volume
SMALLEST_MM, LARGEST_MM = 5.0, 2000.0  # longest side of what may be a finger

# The edges on which nodes 4, 5, … of a quadratic tetrahedron and 8, 9, … of a quadratic hexahedron lie (VTK's order).
EDGES = {
    4: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    8: [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
}
BEND = 0.02  # of an edge: middle nodes farther off it are worth a word


@dataclass(frozen=True)
class MeshFile:
    """What a file holds, with coordinates in mm.

    Attributes
    ----------
    points
        (N, 3) corners of elements [mm].
    elements
        (E, 4) or (E, 8) corners of each element in the order of VTK.
    group
        Function from a name to the corners (F, 3) or (F, 4) of the named facets, or to a mask (N,) of named points;
        None where the file has no such group.
    groups
        Names of all groups.
    bend
        Largest distance of a middle node from its straight edge, as a fraction of the edge [–].
    """

    points: Array
    elements: NDArray[np.int64]
    group: Callable[[str], Facets | NDArray[np.bool_] | None]
    groups: list[str]
    bend: float


def read(path: Path, unit: str) -> MeshFile:
    """Read whatever meshio reads; nothing in the file is ever run as code.

    Raises
    ------
    InputError
        When the file is missing, unreadable, without a volume mesh of one supported kind of cell, or when its size
        does not suit `unit`.
    """
    raw = _read(path)
    kind = _volume_cells(raw, path)
    cells = np.concatenate([block.data for block in raw.cells if block.type == kind]).astype(np.int64)
    elements = cells[:, : CORNERS[kind]]
    used, corners = np.unique(elements, return_inverse=True)
    points = np.asarray(raw.points, dtype=np.float64) * MM[unit]
    if not np.isfinite(points[used]).all():
        raise InputError(f"{path} has nodes whose coordinates are not finite numbers: export the mesh again.")
    _check_size(points[used], path, unit)
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))

    def group(name: str) -> Facets | NDArray[np.bool_] | None:
        facets = [number[raw.cells[block].data[rows][:, :count]] for block, rows, count in _named_cells(raw, name)]
        if facets:
            return np.concatenate(facets).astype(np.int64)
        named = _named_points(raw, name)
        return None if named is None else named[used]

    return MeshFile(points[used], corners.reshape(elements.shape), group, _names(raw), _bend(points, cells, kind))


def _read(path: Path) -> "meshio.Mesh":
    import meshio

    if not path.is_file():
        raise InputError(f"There is no mesh file {path}: give its path as finger.path=FILE.")
    told = io.StringIO()
    try:  # meshio's readers raise all sorts of errors, print, and end the process
        with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        why = " ".join(str(error).split())[:120] if not isinstance(error, SystemExit) else "its format is another one"
        raise InputError(
            f"{path} cannot be read as a mesh ({type(error).__name__}: {why}); export it as Gmsh .msh, VTK .vtu or "
            "Abaqus .inp."
        ) from error


def _volume_cells(raw: "meshio.Mesh", path: Path) -> str:
    """The one kind of volume cell in the file."""
    kinds = sorted({block.type for block in raw.cells if block.type not in LESSER and len(block.data)})
    if not kinds:
        raise InputError(f"{path} has no volume elements, only surfaces or lines: mesh the volume (3-D) and save that.")
    if len(kinds) > 1 or kinds[0] not in CORNERS:
        raise InputError(
            f"{path} has elements of type {', '.join(kinds)}; a finger is meshed with one of {', '.join(CORNERS)}."
        )
    return kinds[0]


def _check_size(points: Array, path: Path, unit: str) -> None:
    sides = np.ptp(points, axis=0)
    if SMALLEST_MM <= sides.max() <= LARGEST_MM:
        return
    fitting = [name for name, mm in MM.items() if 20 <= sides.max() / MM[unit] * mm <= 500]
    remedy = f"finger.unit={fitting[0]} would make it a finger" if fitting else "check the file and finger.unit"
    size = " × ".join(f"{side / MM[unit]:.3g}" for side in sides)
    raise InputError(f"{path} is {size} {unit} large, which is no finger: {remedy}.")


def _bend(points: Array, cells: NDArray[np.int64], kind: str) -> float:
    edges = EDGES[CORNERS[kind]]
    if cells.shape[1] < CORNERS[kind] + len(edges):
        return 0.0
    ends = points[cells[:, edges]]  # (E, edges, 2, 3)
    middles = points[cells[:, CORNERS[kind] : CORNERS[kind] + len(edges)]]
    off = np.linalg.norm(middles - ends.mean(axis=2), axis=2)
    return float((off / np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).clip(1e-300)).max())


def _names(raw: "meshio.Mesh") -> list[str]:
    own = {*raw.cell_sets, *raw.field_data, *raw.point_sets, *raw.cell_data, *raw.point_data}
    return sorted(name for name in own if not name.startswith("gmsh:"))


def _named_cells(raw: "meshio.Mesh", name: str) -> Iterator[tuple[int, NDArray[Any], int]]:
    """Block of cells, rows in it, and number of corners, of all facets that `name` stands for."""
    for block, cells in enumerate(raw.cells):
        if cells.type not in FACET_CORNERS:
            continue
        rows = np.zeros(len(cells.data), dtype=bool)
        members = raw.cell_sets.get(name)
        if members is not None and block < len(members) and members[block] is not None:
            rows[np.asarray(members[block], dtype=np.int64)] = True
        if name in raw.field_data and "gmsh:physical" in raw.cell_data:
            tag, dimension = raw.field_data[name]
            if dimension == 2:
                rows |= np.asarray(raw.cell_data["gmsh:physical"][block]) == tag
        if name in raw.cell_data:
            rows |= np.asarray(raw.cell_data[name][block]) != 0
        if rows.any():
            yield block, np.flatnonzero(rows), FACET_CORNERS[cells.type]


def _named_points(raw: "meshio.Mesh", name: str) -> NDArray[np.bool_] | None:
    """Mask of the points that `name` stands for."""
    if name in raw.point_sets:
        named = np.zeros(len(raw.points), dtype=bool)
        named[np.asarray(raw.point_sets[name], dtype=np.int64)] = True
        return named
    if name in raw.point_data:
        return np.any(np.reshape(raw.point_data[name], (len(raw.points), -1)) != 0, axis=1)
    return None


def to_skfem(file: MeshFile) -> "Mesh":
    """The elements of `file` as a mesh of scikit-fem [mm]."""
    from skfem import MeshHex, MeshTet
    from skfem.io.meshio import INV_HEX_MAPPING

    if file.elements.shape[1] == 4:
        return MeshTet(np.ascontiguousarray(file.points.T), np.ascontiguousarray(file.elements.T))
    order = INV_HEX_MAPPING[:8]
    return MeshHex(np.ascontiguousarray(file.points.T), np.ascontiguousarray(file.elements.T[order]))
