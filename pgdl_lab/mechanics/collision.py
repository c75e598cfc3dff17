"""Collision meshes of the IPC Toolkit, and what is near what on them."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.skin import Samples

if TYPE_CHECKING:
    import ipctk

Array = NDArray[np.float64]
T = TypeVar("T")


def moved(mesh: "ipctk.CollisionMesh", displacement: Array) -> Array:
    """Vertices (V, 3) of `mesh` at a displacement of all nodes (N, 3) [mm]."""
    vertices: Array = mesh.displace_vertices(np.asfortranarray(displacement))
    return vertices


def thinned(mesh: "ipctk.CollisionMesh", vertices: Array, by_mm: float) -> Array:
    """`vertices` (V, 3) moved into the body by `by_mm` [mm], where triangles are not much smaller than that.

    None moves by more than a quarter of the shortest edge at it, so that no triangle is turned over.
    """
    corners = vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards, most = np.zeros_like(vertices), np.full(len(vertices), np.inf)
    ends = vertices[mesh.edges]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    for corner in mesh.faces.T:
        np.subtract.at(inwards, corner, normals)
    for end in mesh.edges.T:
        np.minimum.at(most, end, length / 4)
    size = np.linalg.norm(inwards, axis=1, keepdims=True)
    result: Array = vertices + np.minimum(most, by_mm)[:, None] * inwards / np.where(size > 0, size, 1.0)
    return result


def collisions(mesh: "ipctk.CollisionMesh", vertices: Array, distance_mm: float) -> "ipctk.NormalCollisions":
    """What is nearer than `distance_mm` on `mesh` with its `vertices` (V, 3) [mm]."""
    import ipctk

    candidates, found = ipctk.Candidates(), ipctk.NormalCollisions()
    found.use_area_weighting = True
    # Boxes around all that can meet are inflated by half of it, but a plane has no box.
    candidates.build(mesh, vertices, distance_mm if mesh.planes else distance_mm / 2)
    found.build(candidates, mesh, vertices, distance_mm)
    return found


def collision_mesh(samples: Samples) -> "ipctk.CollisionMesh":
    """The triangles of `samples`, all of which can meet."""
    import ipctk

    return ipctk.CollisionMesh(
        np.asfortranarray(samples.positions),
        ipctk.edges(samples.triangles),
        samples.triangles,
        samples.interpolation.tocsc(),
    )


def each(found: "ipctk.NormalCollisions", what: Callable[["ipctk.NormalCollision"], T]) -> Iterator[T]:
    """`what` is said of each pair that was `found`; a pair must not be kept, as its memory goes with that of all."""
    return (what(found[number]) for number in range(len(found)))


def ends(pair: "ipctk.NormalCollision", mesh: "ipctk.CollisionMesh") -> NDArray[np.int64]:
    """Numbers of the vertices of `pair`, two to four."""
    return np.array([vertex for vertex in pair.vertex_ids(mesh.edges, mesh.faces) if vertex >= 0])
