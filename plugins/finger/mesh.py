"""The user's own finger, from a volume mesh file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.finger import Finger
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.meshfile import MM
from pgdl_lab.registry import register

if TYPE_CHECKING:
    from skfem import Mesh as FemMesh


@register("finger", "mesh")
@dataclass(frozen=True)
class Mesh(Finger):
    """A finger that was meshed elsewhere: tetrahedra or hexahedra in one file that meshio reads (.msh, .vtu, .inp, …).

    In the file x runs from the clamp to the tip, z up and y to the side; the file holds the whole finger, or the half
    on the side of larger y with its plane of symmetry as a group. It is moved so that the clamp begins at x = 0 and the
    lowest point lies at z = 0. A group is a physical surface (Gmsh), a set of facets or nodes, or an array of nodes or
    facets that is not 0 (VTK). Observed is the surface around the largest y as far as its normal points mostly to +y.
    Elements are used as they are, with straight edges: fem.edge_mm has no effect.

    Attributes
    ----------
    path
        The mesh file.
    unit
        Its unit of length: mm, cm, m, um or inch.
    clamp
        Name of the group that is held fixed.
    cavity
        Name of the group of all walls that the air presses on.
    symmetry
        Name of the group in the plane of symmetry; if the file has none, it holds the whole finger.
    """

    path: str = ""
    unit: str = "mm"
    clamp: str = "clamp"
    cavity: str = "cavity"
    symmetry: str = "symmetry"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.unit not in MM:
            raise InputError(f"finger.unit is '{self.unit}'; choose one of {', '.join(MM)}.")

    def files(self) -> Sequence[Path]:
        if not Path(self.path).is_file():
            raise InputError(f"finger.path is '{self.path}', and there is no such file: give that of your mesh.")
        return (Path(self.path),)

    def content(self) -> Iterable[bytes | NDArray[Any]]:
        mesh = self.mesh(0.0)  # as it was read: a file may be one of several, or hold what is not used
        named = ((name.encode(), facets) for name, facets in sorted(mesh.boundaries.items()))
        return mesh.p, mesh.t, *chain.from_iterable(named)

    def mesh(self, edge_mm: float) -> "FemMesh":
        from pgdl_lab.mechanics.meshbody import load

        return load(self.files()[0], self.unit, self.clamp, self.cavity, self.symmetry)

    def face(self, points: int) -> Face:
        from pgdl_lab.mechanics.side import observe_side

        return observe_side(self.mesh(0.0), points)
