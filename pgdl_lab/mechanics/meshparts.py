"""The parts of a body's surface that hold it and that the air presses on, as its user says them."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.meshaxes import is_limit, within
from pgdl_lab.mechanics.meshcavity import Chamber, inner_surfaces
from pgdl_lab.mechanics.meshfile import MM, MeshFile
from pgdl_lab.mechanics.meshplace import IN_PLANE
from pgdl_lab.mechanics.meshsurface import NEAR, distances, is_surface, triangles

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Boundaries = dict[str, Index]

WHOLE = "none"
"""What says that a file holds a whole finger, whatever its groups are called."""


@dataclass(frozen=True)
class Parts:
    """What a user says of each part.

    That is a group of the file, the number of a group without a name, where the part lies, as in "x<1", or a surface
    file on which it lies. If a file has no group of the default name, its cavity is all closed inner surfaces, and it
    holds a whole finger.
    """

    clamp: str = "clamp"
    cavity: str = "cavity"
    symmetry: str = "symmetry"


class Surface:
    """The boundary of a body, on which its parts are found.

    Parameters
    ----------
    mesh
        The body along the axes of the lab, in the place that it has in the file [mm].
    file
        What was read from `path`, whose unit of length is `unit`.
    axes
        (3, 3) the axes of the lab in terms of the file's.
    """

    def __init__(self, mesh: "Mesh", file: MeshFile, path: Path, unit: str, axes: Array) -> None:
        self.mesh, self.file, self.path = mesh, file, path
        self._axes, self._mm = axes, MM[unit]
        self.facets = mesh.boundary_facets()
        self._corners = mesh.facets[:, self.facets]

    def boundaries(self, parts: Parts) -> tuple[Boundaries, list[Chamber]]:
        """Facets of each part, and of the chambers that were found because none is named.

        Raises
        ------
        InputError
            When a part is not there, is not on the surface, or shares facets with another one.
        """
        found: Boundaries = {}
        if parts.symmetry not in (WHOLE, *self._absent("symmetry", parts.symmetry)):
            found["symmetry"] = self._part("symmetry", parts.symmetry, found)
        asked = [("clamp", parts.clamp)]
        unnamed = bool(self._absent("cavity", parts.cavity))
        if not unnamed:
            # Nodes and places say less of a rim than facets do: what is sure is taken first.
            asked.insert(0 if self._is_sure(parts.cavity) else 1, ("cavity", parts.cavity))
        for field, text in asked:
            found[field] = self._part(field, text, found)
        if not unnamed:
            return found, []
        chambers = inner_surfaces(self.mesh.with_boundaries(found))
        if not chambers:
            raise InputError(
                f"{self.path} has no group '{parts.cavity}' for finger.cavity, and no closed inner surface that ends "
                "only at the clamp or in a named plane of symmetry: name the walls of the cavity; its groups are "
                f"{self.file.groups.listing()}."
            )
        found["cavity"] = np.concatenate([chamber.facets for chamber in chambers])
        return found, chambers

    def plane_of_least_y(self, parts: Parts) -> str | None:
        """A group that is none of `parts` and lies in the plane of the least y; None if there is none."""
        y = self.mesh.p[1]
        for name in self.file.groups.names:
            facets = self.file.facets(name)
            if facets is None or name in (parts.clamp, parts.cavity) or (facets < 0).any():
                continue
            if np.ptp(y) > 0 and y[facets].max() <= y.min() + IN_PLANE * np.ptp(self.mesh.p, axis=1).max():
                return name
        return None

    def _absent(self, field: str, text: str) -> tuple[str, ...]:
        """`text` if it is the default for this part and the file has no such group."""
        return (text,) if text == getattr(Parts, field) and text not in self.file.groups.names else ()

    def _is_sure(self, text: str) -> bool:
        return self.file.facets(text) is not None or is_surface(text)

    def _part(self, field: str, text: str, taken: Boundaries) -> Index:
        """Facets of the boundary that `text` stands for."""
        sure, what = True, f"The group '{text}' in {self.path}"
        if (named := self.file.facets(text)) is not None:
            found = self._facets(named, text)
        elif (marked := self.file.nodes(text)) is not None:
            sure, found = False, self._all_in(marked)
        elif is_limit(text):
            sure, found, what = False, self._all_in(within(text, self._place(field, taken), f"finger.{field}")), text
            if field == "clamp":  # holds from outside
                inner = [chamber.facets for chamber in inner_surfaces(self.mesh)]
                found = np.setdiff1d(found, np.concatenate([*inner, []]))
        elif is_surface(text):
            found = self._on(Path(text), field)
        else:
            raise InputError(self._missing(field, text))
        if not sure:  # a rim belongs to two parts, and on a coarse mesh a facet may have all its corners on it
            found = np.setdiff1d(found, np.concatenate([*taken.values(), []]))
        if not found.size:
            raise InputError(
                f"{what} holds no whole facet of the surface for finger.{field}: name its facets, or widen the place."
            )
        for other, facets in taken.items():
            if shared := np.intersect1d(facets, found).size:
                raise InputError(
                    f"{shared} facets of {self.path} are in both the groups for finger.{other} and finger.{field}: "
                    "a facet can be in one."
                )
        return found.astype(np.int64)

    def _facets(self, named: Index, name: str) -> Index:
        """Facets of the boundary with the corners `named` (F, 3 or 4)."""
        number = dict(zip(map(tuple, np.sort(self._corners.T, axis=1).tolist()), self.facets, strict=True))
        numbers = [number.get(facet, -1) for facet in map(tuple, np.sort(named, axis=1).tolist())]
        found = np.unique(numbers)
        if found[0] < 0:
            raise InputError(
                f"{numbers.count(-1)} of {len(numbers)} facets of the group '{name}' in {self.path} are not on the "
                "surface of the volume mesh: name surfaces of the solid only, and see that the file has all volumes "
                "(Gmsh leaves out those that are in no physical group)."
            )
        return found

    def _all_in(self, nodes: NDArray[np.bool_]) -> Index:
        """Facets of the boundary all of whose corners are in a mask (N,) of nodes."""
        return self.facets[nodes[self._corners].all(axis=0)]

    def _place(self, field: str, taken: Boundaries) -> Array:
        """Nodes (N, 3) from the least x and z and the middle of y, or the plane of symmetry, as the finger will lie."""
        low, high = self.mesh.p.min(axis=1), self.mesh.p.max(axis=1)
        half = field == "symmetry" or "symmetry" in taken
        return (self.mesh.p.T - [low[0], low[1] if half else (low[1] + high[1]) / 2, low[2]]).astype(np.float64)

    def _on(self, path: Path, field: str) -> Index:
        """Facets of the boundary that lie on the surface in a file with the unit and axes of the mesh."""
        if not path.is_file():
            raise InputError(f"finger.{field} is '{path}', and there is no such file: give that of the surface.")
        axes, points = self._axes, self.mesh.p.T
        surface = triangles(path) @ axes.T * self._mm
        ends = points[np.stack([self._corners, np.roll(self._corners, 1, axis=0)])]
        near = NEAR * float(np.linalg.norm(ends[0] - ends[1], axis=2).mean())
        nodes, middles = np.unique(self._corners), points[self._corners].mean(axis=0)
        on = np.zeros(len(points), dtype=bool)
        on[nodes] = np.isfinite(distances(points[nodes], surface, near))
        found = on[self._corners].all(axis=0) & np.isfinite(distances(middles, surface, 2 * near))
        if not found.any():
            spans = ", the body ".join(
                " × ".join(f"{low:.4g}…{high:.4g}" for low, high in zip(box.min(axis=0), box.max(axis=0), strict=True))
                for box in (surface.reshape(-1, 3) @ axes, points @ axes)
            )
            raise InputError(
                f"No facet of {self.path} lies within {near:.2g} mm of {path} (the surface spans {spans} mm): both "
                "need the same unit, axes and place."
            )
        return self.facets[found]

    def _missing(self, field: str, name: str) -> str:
        """What to tell of a part that is not there."""
        groups = self.file.groups
        if name in groups.names:
            return (
                f"The group '{name}' of {self.path} holds {groups.holding(name)}, but finger.{field} needs facets or "
                f"nodes of the surface; the groups of the file are {groups.listing()}."
            )
        where = " Or say where it lies, e.g. \"finger.clamp='x<1'\"." if field == "clamp" else ""
        return (
            f"{self.path} has no group '{name}' of facets or nodes for finger.{field}; its groups are "
            f"{groups.listing()}.{groups.like(name)}{where}"
        )


def unnamed(chambers: list[Chamber], path: Path, axes: Array) -> list[str]:
    """What to tell of closed inner surfaces that are in no part; `axes` (3, 3) are the lab's in terms of the file's."""
    if not chambers:
        return []
    surfaces = f"{len(chambers)} more closed inner surface{'s' if len(chambers) > 1 else ''}"
    told = " and ".join(chamber.told(axes) for chamber in chambers)
    return [
        f"{path} has {surfaces} in no group of finger.cavity, {told}, where no air presses: put them in the group if "
        "it should."
    ]
