"""A mesh file as meshio reads it; where it cannot, its own reason is told."""

import contextlib
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.hdf5 import require_contained

if TYPE_CHECKING:
    import meshio

FORMATS = {".msh": "Gmsh .msh", ".vtu": "VTK .vtu", ".inp": "Abaqus .inp"}
LONGEST = 160  # characters of a reason that are told
POINTER = b"version https://git-lfs"  # how such a file begins
XDMF = (".xdmf", ".xmf")  # XML that names files with numbers
VOXEL = 11  # the number of its kind in VTK
TEXT = re.compile(rb'<(?:Data)?Array\b(?=[^>]*\btype="String")[^>]*\bName="([^"]*)"')


@dataclass(frozen=True)
class RawMesh:
    """What meshio made of a file, and what it printed about it."""

    mesh: "meshio.Mesh"
    told: str


def read_raw(path: Path) -> RawMesh:
    """Read whatever meshio reads; nothing in the file is ever run as code.

    Raises
    ------
    InputError
        When the file is missing or unreadable, when it asks for more memory or other files than a mesh does, or when
        meshio leaves some of its cells out.
    """
    import meshio

    if not path.is_file():
        raise InputError(f"There is no mesh file {path}: give its path as finger.path=FILE.")
    with path.open("rb") as file:
        if file.read(len(POINTER)) == POINTER:
            raise InputError(f"{path} is a pointer of Git LFS in the place of the mesh: fetch it by 'git lfs pull'.")
    _require_contained(path)
    printed = io.StringIO()
    try:  # meshio's readers raise all sorts of errors, print, and end the process
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:
        raise InputError(_refusal(path, _reason(error, printed.getvalue()))) from error
    told = _one_line(printed.getvalue())
    if "cells that meshio cannot handle" in told:
        kinds = sorted({int(number) for number in re.findall(r"\(type (\d+)\)", told)})
        remedy = "convert them to hexahedra" if kinds == [VOXEL] else "mesh with tetrahedra or hexahedra"
        voxels = ", voxels" if kinds == [VOXEL] else ""
        raise InputError(
            f"{path} has cells that meshio leaves out (VTK's type {', '.join(map(str, kinds))}{voxels}), so a part of "
            f"the body would be missing: {remedy}."
        )
    return RawMesh(mesh, told)


def _require_contained(path: Path) -> None:
    """Check that what HDF5 reads for the file lies in it, or beside it if XDMF names it, and is no larger than that.

    Raises
    ------
    InputError
        When it is not so.
    """
    import h5py

    try:
        for file in (path, *_named(path)):
            if h5py.is_hdf5(file):
                with h5py.File(file, "r") as opened:
                    require_contained(opened, packed=True)
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not taken as a mesh: {_one_line(str(error))}; export the mesh again.") from error


def _named(path: Path) -> list[Path]:
    """The files with numbers that an XDMF file names."""
    if path.suffix.lower() not in XDMF:
        return []
    try:
        items = ElementTree.parse(path).iter("DataItem")
    except ElementTree.ParseError:
        return []  # meshio says more
    texts = [item.text or "" for item in items if item.get("Format") in ("HDF", "Binary")]
    names = dict.fromkeys(text.strip().partition(":")[0] for text in texts)
    for name in names:
        if Path(name).name != name:
            raise ValueError(f"its numbers lie in another folder, in '{name}'")
    return [path.with_name(name) for name in names if name]


def _reason(error: BaseException, printed: str) -> str:
    """Why meshio gave up: its error, or what it printed before it ended the process."""
    if not isinstance(error, SystemExit):
        return f"{type(error).__name__}: {_one_line(str(error))}"
    told, _, _ = printed.partition("Error: Couldn't read file")  # only repeats the path
    return _one_line(told)


def _refusal(path: Path, reason: str) -> str:
    """A sentence for a file that meshio cannot read, with a remedy for this one."""
    says = f"meshio says '{reason.rstrip('.')[:LONGEST]}'" if reason else "meshio gives no reason"
    texts = [name.decode(errors="replace") for name in dict.fromkeys(TEXT.findall(path.read_bytes()))]
    if texts and "data type 'String'" in reason:
        arrays = " and ".join(f"'{name}'" for name in texts)
        return (
            f"{path} holds text in the array {arrays}, which meshio cannot read ({says}): save it without, e.g. by the "
            f"filter 'Pass Arrays' of ParaView, or after del mesh.field_data['{texts[0]}'] in pyvista."
        )
    if "gmsh:physical" in reason:
        return (
            f"{path} has elements in physical groups and others in none, which meshio cannot read in format 4.1 of "
            f"Gmsh ({says}): save it in format 2.2 (Mesh.MshFileVersion=2.2), or put every volume and surface in a "
            "group."
        )
    others = [name for suffix, name in FORMATS.items() if suffix != path.suffix.lower()]
    return f"{path} cannot be read as a mesh ({says}): export it again, or as one of {', '.join(others)}."


def _one_line(text: str) -> str:
    return " ".join(text.split())
