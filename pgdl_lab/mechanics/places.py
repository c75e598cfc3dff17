"""The value of a field of nodes at places in a body, its surface included."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import Discretisation

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NEAR = 1e-6  # of the body: what is so near to the box around an element may lie in it
ITERATIONS = 8  # of Newton's method for the place in an element; one does in a box


def interpolation_at(discretisation: Discretisation, places: Array) -> "csr_matrix":
    """Interpolation (P, N) from the nodes to undeformed `places` (P, 3) [mm] in the body or on its surface.

    A place counts for the element that it lies deepest in, so that round-off puts none on a surface outside.
    """
    from scipy.sparse import csr_matrix

    basis, place, element = discretisation.basis, *_candidates(discretisation, places)
    local = _local(discretisation, places[place], element)
    depth = np.minimum(local, 1 - local).min(axis=(0, 2))
    if basis.mesh.t.shape[0] == 4:  # barycentric: the fourth coordinate
        depth = np.minimum(depth, 1 - local.sum(axis=0)[:, 0])
    order = np.lexsort((-depth, place))
    _, first = np.unique(place[order], return_index=True)
    best = order[first]
    local, element = local[:, best], element[best]
    nodes = discretisation.nodes[element]
    shape = [basis.elem.gbasis(basis.mapping, local, number, tind=element)[0] for number in range(nodes.shape[1])]
    weights = np.stack([np.asarray(each)[:, 0] for each in shape], axis=1)
    rows = np.repeat(np.arange(len(places)), nodes.shape[1])
    return csr_matrix((weights.ravel(), (rows, nodes.ravel())), shape=(len(places), len(discretisation.positions)))


def _local(discretisation: Discretisation, places: Array, element: Index) -> Array:
    """Where in the reference of its `element` (C,) each of `places` (C, 3) lies: (3, C, 1), also outside."""
    mapping, at = discretisation.basis.mapping, places.T[:, :, None]
    local = np.full(at.shape, 0.5)
    for _ in range(ITERATIONS):
        step = np.einsum("ijcq,jcq->icq", mapping.invDF(local, element), at - mapping.F(local, element))
        local = np.clip(local + step, -1.0, 2.0)
    return local


def _candidates(discretisation: Discretisation, places: Array) -> tuple[Index, Index]:
    """Numbers of a place and of an element (C,) each: all pairs of which the place is in the box around the element."""
    from scipy.spatial import cKDTree

    corners = discretisation.basis.mesh.p[:, discretisation.basis.mesh.t]  # (3, 4 or 8, E)
    near = NEAR * float(np.ptp(places, axis=0).max())
    low, high = corners.min(axis=1).T - near, corners.max(axis=1).T + near
    radius = float(np.linalg.norm(high - low, axis=1).max()) / 2
    found = cKDTree((low + high) / 2).query_ball_point(places, radius)
    place = np.repeat(np.arange(len(places)), [len(each) for each in found])
    element = np.concatenate([np.asarray(each, dtype=np.int64) for each in found])
    inside = ((places[place] >= low[element]) & (places[place] <= high[element])).all(axis=1)
    return place[inside], element[inside]
