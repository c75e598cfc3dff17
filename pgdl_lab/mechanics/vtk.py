"""Elements in the node order of VTK, as meshio and ParaView expect them."""

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import Discretisation, cells_of

# Reference positions of the nodes of a triquadratic hexahedron (VTK file formats, cell type 29); the first 20 are those
# of the serendipity hexahedron (cell type 25).
HEXAHEDRON = (
    np.array(
        [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]]
        + [[1, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0], [1, 0, 2], [2, 1, 2], [1, 2, 2], [0, 1, 2]]
        + [[0, 0, 1], [2, 0, 1], [2, 2, 1], [0, 2, 1]]
        + [[0, 1, 1], [2, 1, 1], [1, 0, 1], [1, 2, 1], [1, 1, 0], [1, 1, 2], [1, 1, 1]]
    )
    / 2
)
# The first 10 are those of the quadratic tetrahedron (cell type 24); VTK has no more. Then the centres of the
# facets, and the centre.
TETRAHEDRON = (
    np.array(
        [[0, 0, 0], [12, 0, 0], [0, 12, 0], [0, 0, 12]]
        + [[6, 0, 0], [6, 6, 0], [0, 6, 0], [0, 0, 6], [6, 0, 6], [0, 6, 6]]
        + [[4, 4, 0], [4, 0, 4], [4, 4, 4], [0, 4, 4], [3, 3, 3]]
    )
    / 12
)
NODES = {"hexahedra": HEXAHEDRON, "tetrahedra": TETRAHEDRON}


def ordered_cells(mesh: Discretisation) -> NDArray[np.int64]:
    """Node numbers (E, A) of right-handed elements, each in the order of `HEXAHEDRON` or `TETRAHEDRON`."""
    local = mesh.basis.elem.doflocs
    tetrahedra = cells_of(mesh.basis.mesh) == "tetrahedra"
    wanted = NODES[cells_of(mesh.basis.mesh)][: len(local)]

    def cells(order: NDArray[np.float64]) -> NDArray[np.int64]:
        return mesh.nodes[:, [int(np.flatnonzero(np.isclose(local, node).all(axis=1))[0]) for node in order]]

    right = cells(wanted)
    along = (1, 2, 3) if tetrahedra else (1, 3, 4)
    x, y, z = (mesh.positions[right[:, corner]] - mesh.positions[right[:, 0]] for corner in along)
    left_handed = np.einsum("ei,ei->e", np.cross(x, y), z) < 0  # scikit-fem allows this, VTK does not
    return np.where(left_handed[:, None], cells(wanted[:, [1, 0, 2]]), right)


def vtk_cells(mesh: Discretisation) -> tuple[str, NDArray[np.int64]]:
    """Name in meshio of the elements of `mesh`, and their node numbers (E, A) in the order of VTK.

    Hexahedra have 20 or 27 nodes; of tetrahedra with more than 10 the others are left out.
    """
    cells = ordered_cells(mesh)
    if cells_of(mesh.basis.mesh) == "tetrahedra":
        return "tetra10", cells[:, :10]
    return f"hexahedron{cells.shape[1]}", cells
