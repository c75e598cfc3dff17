"""Elements in the node order of VTK, as meshio and ParaView expect them."""

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import Discretisation

# Node positions of the triquadratic hexahedron in units of half an edge (VTK file formats, cell type 29); the first 20
# are those of the serendipity hexahedron (cell type 25).
NODES = np.array(
    [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]]
    + [[1, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0], [1, 0, 2], [2, 1, 2], [1, 2, 2], [0, 1, 2]]
    + [[0, 0, 1], [2, 0, 1], [2, 2, 1], [0, 2, 1]]
    + [[0, 1, 1], [2, 1, 1], [1, 0, 1], [1, 2, 1], [1, 1, 0], [1, 1, 2], [1, 1, 1]]
)


def vtk_cells(mesh: Discretisation) -> tuple[str, NDArray[np.int64]]:
    """Name in meshio of the hexahedra of `mesh` (20 or 27 nodes), and their node numbers (E, A) in the order of VTK."""
    local = np.rint(2 * mesh.basis.elem.doflocs).astype(int)
    wanted = NODES[: len(local)]

    def cells(order: NDArray[np.int64]) -> NDArray[np.int64]:
        return mesh.nodes[:, [int(np.flatnonzero((local == node).all(axis=1))[0]) for node in order]]

    right = cells(wanted)
    x, y, z = (mesh.positions[right[:, corner]] - mesh.positions[right[:, 0]] for corner in (1, 3, 4))
    left_handed = np.einsum("ei,ei->e", np.cross(x, y), z) < 0  # scikit-fem allows this, VTK does not
    return f"hexahedron{len(local)}", np.where(left_handed[:, None], cells(wanted[:, [1, 0, 2]]), right)
