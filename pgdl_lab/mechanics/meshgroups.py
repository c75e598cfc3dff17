"""The named and numbered groups of a mesh file, whatever a format calls them, and what each of them holds."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import meshio

Facets = NDArray[np.int64]
Nodes = NDArray[np.bool_]

FACET_CORNERS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}
POINTS_AND_LINES = ("vertex", "line", "line3")
NUMBERED = ("gmsh:physical", "medit:ref", "gmsh:geometrical", "CellEntityIds")
"""Numbers of groups that formats keep on cells; the first that a file has counts."""
MOST_TOLD = 12  # groups in a message
FAMILIES = ("cell_tags", "point_tags")  # of Salome: a cell or point has the number of a family, which names its groups


class Groups:
    """The groups of a mesh.

    Parameters
    ----------
    raw
        The mesh as meshio reads it.
    surfaces
        Corners (F, 3 or 4) of further groups of facets, by name.
    """

    def __init__(self, raw: "meshio.Mesh", surfaces: Mapping[str, Facets]) -> None:
        self._raw, self._surfaces = raw, surfaces
        self._numbers = next((name for name in NUMBERED if name in raw.cell_data), None)
        self._named = dict(raw.field_data) if "gmsh:physical" in raw.cell_data else {}
        own = {*raw.cell_sets, *self._named, *raw.point_sets, *raw.cell_data, *raw.point_data, *surfaces}
        own -= {name for name in own if name.startswith("gmsh:") or name in (*NUMBERED, *FAMILIES)}
        self.names = sorted({*own, *self._families("cell"), *self._families("point")})
        self.names += map(str, sorted(self._unnamed()))

    def facets(self, name: str) -> Facets | None:
        """Corners (F, 3 or 4) of the facets that `name` stands for; None if it holds no facets."""
        found = [self._surfaces[name]] if len(self._surfaces.get(name, ())) else []
        for block, rows in self._cells(name):
            if block.type in FACET_CORNERS:
                found.append(block.data[rows][:, : FACET_CORNERS[block.type]])
        return np.concatenate(found).astype(np.int64) if found else None

    def nodes(self, name: str) -> Nodes | None:
        """Mask (N,) of the nodes that `name` stands for as a group of nodes; None if it holds no nodes."""
        raw = self._raw
        named = np.zeros(len(raw.points), dtype=bool)
        if name in raw.point_sets:
            named[np.asarray(raw.point_sets[name], dtype=np.int64)] = True
        elif name in raw.point_data:
            named = _marked(raw.point_data[name])
        elif "point_tags" in raw.point_data:
            named = np.isin(raw.point_data["point_tags"], self._families("point").get(name, []))
        return named if named.any() else None

    def holding(self, name: str) -> str:
        """What the group holds, e.g. "66 volumes"."""
        counts: dict[str, int] = {}
        for block, rows in self._cells(name):
            kind = "facets" if block.type in FACET_CORNERS else "lines or points"
            kind = "volumes" if kind != "facets" and block.type not in POINTS_AND_LINES else kind
            counts[kind] = counts.get(kind, 0) + len(rows)
        counts["facets"] = counts.get("facets", 0) + len(self._surfaces.get(name, ()))
        nodes = self.nodes(name)
        counts["nodes"] = 0 if nodes is None else int(nodes.sum())
        return " and ".join(f"{count} {kind}" for kind, count in counts.items() if count) or "nothing"

    def listing(self) -> str:
        """All groups and what they hold, for a message."""
        told = [f"{name} ({self.holding(name)})" for name in self.names[:MOST_TOLD]]
        if len(self.names) > MOST_TOLD:
            told.append(f"and {len(self.names) - MOST_TOLD} more")
        return ", ".join(told) or "none"

    def like(self, name: str) -> str:
        """A hint at the group whose name is most like `name`, or an empty text."""
        known = {own.lower(): own for own in self.names}
        close = get_close_matches(name.lower(), known, n=1)
        return f" Did you mean '{known[close[0]]}'?" if close else ""

    def _cells(self, name: str) -> Iterator[tuple[Any, NDArray[np.int64]]]:
        """Blocks of cells, and the rows in each, that `name` stands for."""
        raw = self._raw
        number, dimension = self._number(name)
        families = self._families("cell").get(name, [])
        for index, block in enumerate(raw.cells):
            rows = np.zeros(len(block.data), dtype=bool)
            members = raw.cell_sets.get(name)
            if members is not None and index < len(members) and members[index] is not None:
                rows[np.asarray(members[index], dtype=np.int64)] = True
            if number is not None and self._numbers is not None and dimension in (None, block.dim):
                rows |= np.asarray(raw.cell_data[self._numbers][index]) == number
            if families:
                rows |= np.isin(raw.cell_data["cell_tags"][index], families)
            if name in raw.cell_data and name not in (*NUMBERED, *FAMILIES):
                rows |= _marked(raw.cell_data[name][index])
            if rows.any():
                yield block, np.flatnonzero(rows)

    def _number(self, name: str) -> tuple[int | None, int | None]:
        """Number of the group, and the dimension of the cells that it counts for (None: any)."""
        if name in self._named:
            number, dimension = self._named[name]
            return int(number), int(dimension)
        return (int(name), None) if name.isdigit() else (None, None)

    def _unnamed(self) -> set[int]:
        """Numbers of groups of facets without a name."""
        if self._numbers is None:
            return set()
        found: set[int] = set()
        for block, numbers in zip(self._raw.cells, self._raw.cell_data[self._numbers], strict=True):
            if block.type in FACET_CORNERS:
                found |= set(np.unique(numbers).tolist())
        return found - {int(number) for number, dimension in self._named.values() if dimension == 2} - {0}

    def _families(self, kind: str) -> dict[str, list[int]]:
        """Numbers of the families of each of Salome's groups; `kind` is "cell" or "point"."""
        found: dict[str, list[int]] = {}
        for number, names in getattr(self._raw, f"{kind}_tags", {}).items():
            for name in names:
                found.setdefault(name, []).append(int(number))
        return found


def _marked(values: Any) -> Nodes:
    """Which rows of an array are neither zero nor missing."""
    array = np.reshape(values, (len(values), -1))
    if array.dtype.kind not in "biuf":
        return np.zeros(len(array), dtype=bool)
    return np.any(np.nan_to_num(array.astype(np.float64)) != 0, axis=1)
