"""A finger from a volume mesh file: its elements, its unit, its axes and its groups."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.abaqus import surfaces
from pgdl_lab.mechanics.meshcheck import OTHER_HAND, require_sound, right_handed, without_copies
from pgdl_lab.mechanics.meshgroups import FACET_CORNERS, POINTS_AND_LINES, Groups
from pgdl_lab.mechanics.rawmesh import RawMesh, read_raw

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
Facets = NDArray[np.int64]

MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4}
"""Millimetres in each unit of length."""

CORNERS = {"tetra": 4, "tetra10": 4, "hexahedron": 8, "hexahedron20": 8, "hexahedron27": 8}
LESSER = (*POINTS_AND_LINES, *FACET_CORNERS)  # cells without a volume
SMALLEST_MM, LARGEST_MM = 5.0, 2000.0  # longest side of what may be a finger
USUAL_MM = 10.0  # a shorter finger is rare enough to ask

# The edges of a tetrahedron and of a hexahedron.
EDGES = {
    4: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    8: [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
}
BEND = 0.02  # of an edge: middle nodes farther off it are worth a word


@dataclass(frozen=True)
class MeshFile:
    """What a file holds, with coordinates in mm along its own axes.

    Attributes
    ----------
    points
        (N, 3) corners of elements [mm].
    elements
        (E, 4) or (E, 8) corners of each element in the right-handed order of VTK.
    groups
        The groups of the file; their nodes are numbered as in the file.
    number
        Number in `points` of each node of the file, −1 where no element has it.
    notes
        What was put right without asking, in sentences.
    bend
        Largest distance of a middle node from the middle of a straight edge, as a fraction of the edge [–].
    """

    points: Array
    elements: NDArray[np.int64]
    groups: Groups
    number: NDArray[np.int64]
    notes: list[str]
    bend: float

    def facets(self, name: str) -> Facets | None:
        """Corners (F, 3 or 4) of the facets in a group; None if it holds none."""
        found = self.groups.facets(name)
        return None if found is None else self.number[found]

    def nodes(self, name: str) -> NDArray[np.bool_] | None:
        """Mask (N,) of the points in a group of nodes; None if it holds none."""
        found = self.groups.nodes(name)
        return None if found is None else found[self.number >= 0]


def read(path: Path, unit: str) -> MeshFile:
    """Read a mesh file.

    Raises
    ------
    InputError
        When the file is missing, unreadable, without a volume mesh of one supported kind of cell, when its size does
        not suit `unit`, or when its elements are inverted or do not fit together.
    """
    raw = read_raw(path)
    kind = _volume_cells(raw, path)
    cells = np.concatenate([block.data for block in raw.mesh.cells if block.type == kind]).astype(np.int64)
    elements = without_copies(cells[:, : CORNERS[kind]])
    used, corners = np.unique(elements, return_inverse=True)
    placed = np.asarray(raw.mesh.points, dtype=np.float64) * MM[unit]
    if not np.isfinite(placed[used]).all():
        raise InputError(f"{path} has nodes whose coordinates are not finite numbers: export the mesh again.")
    _check_size(placed[used], path, unit)
    number = np.full(len(placed), -1)
    number[used] = np.arange(len(used))
    ordered, reversed_ = right_handed(placed[used], corners.reshape(elements.shape), str(path))
    require_sound(placed[used], ordered, str(path))
    notes = [f"meshio on {path}: {raw.told}"] if raw.told else []
    if len(elements) < len(cells):
        notes.append(f"{len(cells) - len(elements)} of {len(cells)} elements of {path} are there twice: taken once.")
    if reversed_:
        notes.append(f"All elements of {path} are left-handed, as some formats have them: their nodes are reversed.")
    groups = Groups(raw.mesh, surfaces(path, raw.mesh) if path.suffix.lower() == ".inp" else {})
    return MeshFile(placed[used], ordered, groups, number, notes, _bend(placed, cells, kind))


def _volume_cells(raw: RawMesh, path: Path) -> str:
    """The one kind of volume cell in the file."""
    kinds = sorted({block.type for block in raw.mesh.cells if block.type not in LESSER and len(block.data)})
    if not kinds:
        gmsh = any(name.startswith("gmsh:") for name in raw.mesh.cell_data)
        group = " and put the volume in a physical group, as Gmsh leaves out what is in none," if gmsh else ""
        raise InputError(
            f"{path} has no volume elements, only surfaces or lines: mesh the volume (3-D){group} and save that."
        )
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
    length = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).clip(1e-300)
    straight = ends.mean(axis=2)
    # Formats differ in which node belongs to which edge: each is held against the nearest.
    off = [np.linalg.norm(straight - middles[:, [at]], axis=2) / length for at in range(len(edges))]
    return float(max(each.min(axis=1).max() for each in off))


def to_skfem(file: MeshFile, axes: Array) -> "Mesh":
    """The elements of `file` as a mesh of scikit-fem along the axes of the lab, (3, 3) in terms of the file's [mm]."""
    from skfem import MeshHex, MeshTet
    from skfem.io.meshio import INV_HEX_MAPPING

    corners = file.elements.shape[1]
    points, elements = axes @ file.points.T, file.elements.T
    if np.linalg.det(axes) < 0:
        elements = elements[OTHER_HAND[corners]]
    if corners == 4:
        return MeshTet(np.ascontiguousarray(points), np.ascontiguousarray(elements))
    return MeshHex(np.ascontiguousarray(points), np.ascontiguousarray(elements[INV_HEX_MAPPING[:8]]))
