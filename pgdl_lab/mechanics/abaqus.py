"""The surfaces (`*SURFACE`) of an Abaqus input file, which meshio passes over."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import meshio

Facets = NDArray[np.int64]

# Corners of the faces S1, S2, … of an element, as Abaqus numbers them.
FACES: dict[str, list[tuple[int, ...]]] = {
    "tetra": [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)],
    "hexahedron": [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)],
}


def surfaces(path: Path, mesh: "meshio.Mesh") -> dict[str, Facets]:
    """Corners (F, 3 or 4) of the facets of each surface that is made of faces of elements, by its name.

    A surface that names what is not in the file, or whole elements instead of faces, holds no facets.

    Parameters
    ----------
    mesh
        What meshio read from `path`: its blocks are those of the file in turn, and it knows the sets of elements.
    """
    numbered: list[list[int]] = []
    named: dict[str, list[list[str]]] = {}
    for keyword, options, rows in _sections(path):
        if keyword == "ELEMENT":
            numbered.append([int(number) for row in rows for number in row if number])
        elif keyword == "SURFACE" and options.get("TYPE", "ELEMENT").upper() == "ELEMENT" and "NAME" in options:
            named.setdefault(options["NAME"], []).extend(rows)
    if not named or len(numbered) != len(mesh.cells):  # an included file moves the blocks
        return {name: np.empty((0, 3), dtype=np.int64) for name in named}
    row_of: dict[int, tuple[int, int]] = {}
    for block, numbers in enumerate(numbered):
        nodes = np.asarray(mesh.cells[block].data).shape[1]
        for row, number in enumerate(numbers[:: nodes + 1]):
            row_of[number] = block, row
    sets = {name.upper(): members for name, members in mesh.cell_sets.items()}

    def members(name: str) -> Iterator[tuple[int, int]]:
        """Block and row of the elements that `name`, a number or a set, stands for."""
        if name.isdigit():
            yield from [row_of[int(name)]] if int(name) in row_of else []
            return
        for block, rows in enumerate(sets.get(name.upper(), [])):
            yield from ((block, int(row)) for row in rows)

    def facets(rows: list[list[str]]) -> Facets:
        found = []
        for name, face, *_ in (row for row in rows if len(row) > 1):
            for block, row in members(name):
                cells = np.asarray(mesh.cells[block].data)
                faces = FACES.get(mesh.cells[block].type.rstrip("0123456789"), [])
                names = [f"S{number}" for number in range(1, len(faces) + 1)]
                if face.upper() in names:
                    found.append(cells[row][list(faces[names.index(face.upper())])])
        return np.array(found, dtype=np.int64) if found else np.empty((0, 3), dtype=np.int64)

    return {name: facets(rows) for name, rows in named.items()}


def _sections(path: Path) -> Iterator[tuple[str, dict[str, str], list[list[str]]]]:
    """Keyword, options and data rows of each section of the file."""
    keyword = ""
    options: dict[str, str] = {}
    rows: list[list[str]] = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("**") or not line.strip():
            continue
        cells = [cell.strip() for cell in line.strip().rstrip(",").split(",")]
        if not line.startswith("*"):
            rows.append(cells)
            continue
        if keyword:
            yield keyword, options, rows
        pairs = [cell.partition("=") for cell in cells[1:]]
        keyword, rows = cells[0].lstrip("*").upper(), []
        options = {name.strip().upper(): value.strip() for name, _, value in pairs}
    if keyword:
        yield keyword, options, rows
