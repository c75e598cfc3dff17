"""How much memory a simulation takes, told before it begins: a machine that runs out of it ends programs at will."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.elements import ElementKind, cells_of

if TYPE_CHECKING:
    from skfem import Mesh

# Measured as the largest memory of the process (benchmarks/memory.py): within 20 % from 13,000 to 410,000 unknowns.
ASSEMBLY = 4.7  # numbers that are held at the worst moment, for each entry of the element matrices
FACTORS = 330.0  # bytes of MKL Pardiso's factors, over the number of unknowns to the power of `GROWTH`
GROWTH = 1.25
PROCESS = 1e8  # bytes of the program itself
GB = 1e9
LONGER, STEPS = 1.1, 40  # edges that are tried where the wanted ones are too short


class TooLarge(InputError):
    """A mesh that needs more memory than there is."""


@dataclass(frozen=True)
class Size:
    """How many vertices, edges, facets and cells a mesh has; `hexahedra` or, if not, tetrahedra."""

    vertices: int
    edges: int
    facets: int
    cells: int
    hexahedra: bool

    @classmethod
    def of(cls, mesh: "Mesh") -> "Size":
        """The size of `mesh`."""
        hexahedra = cells_of(mesh) == "hexahedra"
        return cls(int(mesh.nvertices), int(mesh.nedges), int(mesh.nfacets), int(mesh.nelements), hexahedra)

    def refined(self) -> "Size":
        """That of the mesh with every edge halved."""
        v, e, f, c = self.vertices, self.edges, self.facets, self.cells
        if self.hexahedra:
            return Size(v + e + f + c, 2 * e + 4 * f + 6 * c, 4 * f + 12 * c, 8 * c, True)
        return Size(v + e, 2 * e + 3 * f + c, 4 * f + 8 * c, 8 * c, False)

    def unknowns(self, kind: ElementKind) -> int:
        """Components of the displacements of all nodes."""
        import skfem

        element = getattr(skfem, kind.shape)()
        per = element.nodal_dofs, element.edge_dofs, element.facet_dofs, element.interior_dofs
        counts = self.vertices, self.edges, self.facets, self.cells
        return 3 * sum(each * count for each, count in zip(per, counts, strict=True))

    def needed(self, kind: ElementKind) -> float:
        """Memory for an equilibrium on elements of this `kind` [bytes]."""
        import skfem

        entries = self.cells * (3 * len(getattr(skfem, kind.shape)().doflocs)) ** 2
        return PROCESS + 8 * ASSEMBLY * entries + FACTORS * self.unknowns(kind) ** GROWTH


def require(mesh: "Mesh", kind: ElementKind, edge_mm: float, remesh: Callable[[float], "Mesh"], refined: bool) -> None:
    """Check that there is memory for equilibria on `mesh`, or on it `refined`, with elements of this `kind`.

    Parameters
    ----------
    edge_mm
        The longest edge that was asked for [mm].
    remesh
        Makes the mesh for another [mm].

    Raises
    ------
    TooLarge
        When there is not; the message names an edge that would do.
    """

    def size(mesh: "Mesh") -> Size:
        return Size.of(mesh).refined() if refined else Size.of(mesh)

    found, free = size(mesh), available()
    if (needed := found.needed(kind)) <= free:
        return
    edges = (edge_mm * LONGER**step for step in range(1, STEPS))
    enough = next((edge for edge in edges if size(remesh(edge)).needed(kind) <= free), None)
    remedies = [f"choose fem.edge_mm={enough:.3g}" if enough else "mesh the body with fewer elements"]
    if refined:
        remedies.append("set fem.estimate_error=false")
    which = ", refined to estimate its error," if refined else ""
    raise TooLarge(
        f"The mesh of fem.edge_mm={edge_mm:g}{which} has {found.cells:,} elements with {found.unknowns(kind):,} "
        f"unknowns: they take some {needed / GB:.2g} GB of memory, and {free / GB:.2g} GB are free; "
        f"{', '.join(remedies)} or close other programs."
    )


def available() -> float:
    """Memory that can be had without swapping [bytes]; infinite where the system does not tell."""
    return min(_of_machine(), _of_group(Path("/sys/fs/cgroup")))


def _of_machine() -> float:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        pass
    try:  # all that there is, used or not
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return float("inf")


def _of_group(root: Path) -> float:
    """What the control group of a container leaves: its limit less what is used and not only cached."""
    for limit, used, cached in (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "total_inactive_file"),
    ):
        try:
            most, held = ((root / name).read_text().strip() for name in (limit, used))
            statistics = dict(line.split() for line in (root / limit).with_name("memory.stat").read_text().splitlines())
        except OSError:
            continue
        return float("inf") if most == "max" else float(most) - float(held) + float(statistics.get(cached, 0))
    return float("inf")
