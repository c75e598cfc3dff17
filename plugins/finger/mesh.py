"""The user's own finger, from a volume mesh file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from glob import escape
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.meshaxes import rotation
from pgdl_lab.mechanics.meshfile import MM
from pgdl_lab.mechanics.meshparts import Parts
from pgdl_lab.mechanics.meshsurface import is_surface

if TYPE_CHECKING:
    from skfem import Mesh as FemMesh

    from pgdl_lab.mechanics.meshbody import MeshBody


@register("finger", "mesh")
@dataclass(frozen=True)
class MeshFinger(Finger):
    """A finger that was meshed elsewhere: tetrahedra or hexahedra in one file that meshio reads (.msh, .vtu, .inp, …).

    In the lab x runs from the clamp to the tip, z up and y to the side; `axes` turns a file in which it does not. The
    file holds the whole finger, or the half on the side of larger y with its plane of symmetry as a group. It is moved
    so that the clamp begins at x = 0 and the lowest point lies at z = 0. Gravity is along the axes of the lab.

    A part of the surface is a group of the file: a physical surface (Gmsh), a surface, a set of facets or nodes, or an
    array of nodes or facets that is not 0 (VTK); the number of a group without a name; where it lies in the lab, in mm
    from the end, the lowest point and the middle or the plane of symmetry (`'x<1'`, `'x<5 and z>=2'`); or a surface
    file (.stl) with the unit and axes of the mesh. Observed is the outermost surface that looks mostly to +y. Elements
    are used as they are, with straight edges: fem.edge_mm has no effect.

    Attributes
    ----------
    path
        The mesh file.
    unit
        Its unit of length: mm, cm, m, um or inch.
    axes
        The file's axes that become x, y and z, e.g. [-x,-z,-y].
    clamp
        The part that is held fixed.
    cavity
        The part that the air presses on; if the file has no group `cavity`, all closed inner surfaces.
    symmetry
        The part in the plane of symmetry; if the file has no group `symmetry`, or for `none`, the finger is whole.
    """

    path: str = ""
    unit: str = "mm"
    axes: list[str] = field(default_factory=lambda: ["x", "y", "z"])
    clamp: str = Parts.clamp
    cavity: str = Parts.cavity
    symmetry: str = Parts.symmetry

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.unit not in MM:
            raise InputError(f"finger.unit is '{self.unit}'; choose one of {', '.join(MM)}.")
        rotation(self.axes)  # refuses what it cannot be

    def files(self) -> Sequence[Path]:
        if not Path(self.path).is_file():
            raise InputError(f"finger.path is '{self.path}', and there is no such file: give that of your mesh.")
        surfaces = [Path(part) for part in (self.clamp, self.cavity, self.symmetry) if is_surface(part)]
        return (Path(self.path), *(path for path in surfaces if path.is_file()))

    def content(self) -> Iterable[bytes | NDArray[Any]]:
        mesh = self.mesh(0.0)  # as it was read: a file may be one of several, or hold what is not used
        named = ((name.encode(), facets) for name, facets in sorted(mesh.boundaries.items()))
        return mesh.p, mesh.t, *chain.from_iterable(named)

    def mesh(self, edge_mm: float) -> "FemMesh":
        return self._body().mesh

    def face(self, points: int) -> Face:
        from pgdl_lab.mechanics.side import observe_side

        return observe_side(self.mesh(0.0), points)

    def whole(self) -> str:
        return "with a mesh of both halves and finger.symmetry=none"

    def finer(self, edge_mm: float) -> str:
        return f"mesh {self.path} finer"

    def doubts(self) -> Sequence[str]:
        return self._body().doubts

    def _body(self) -> "MeshBody":
        from pgdl_lab.mechanics.meshbody import load

        files = self.files()
        beside = files[0].parent.glob(f"{escape(files[0].stem)}.*")  # some formats put the numbers into another file
        found = [path.stat() for path in (*files, *sorted(beside))]
        stamps = tuple(stamp for file in found for stamp in (file.st_mtime_ns, file.st_size))
        return load(files[0], self.unit, tuple(self.axes), Parts(self.clamp, self.cavity, self.symmetry), stamps)
