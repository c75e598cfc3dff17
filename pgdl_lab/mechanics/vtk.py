"""Elements in the node order of VTK, as meshio and ParaView expect them."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from skfem import Element

# Node positions of the triquadratic hexahedron in units of half an edge (VTK file formats, cell type 29); the first 20
# are those of the serendipity hexahedron (cell type 25).
NODES = np.array(
    [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]]
    + [[1, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0], [1, 0, 2], [2, 1, 2], [1, 2, 2], [0, 1, 2]]
    + [[0, 0, 1], [2, 0, 1], [2, 2, 1], [0, 2, 1]]
    + [[0, 1, 1], [2, 1, 1], [1, 0, 1], [1, 2, 1], [1, 1, 0], [1, 1, 2], [1, 1, 1]]
)


def vtk_order(element: "Element") -> tuple[str, NDArray[np.int64]]:
    """Name in meshio of a scikit-fem hexahedron with 20 or 27 nodes, and its local node numbers in the order of VTK."""
    local = np.rint(2 * element.doflocs).astype(int)
    order = [int(np.flatnonzero((local == node).all(axis=1))[0]) for node in NODES[: len(local)]]
    return f"hexahedron{len(local)}", np.array(order, dtype=np.int64)
