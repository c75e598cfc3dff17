"""What is known of a body without any simulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.face_mesh import FaceMesh
from pgdl_lab.core.snapshots import Snapshots
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.surrogate.record import Face


@dataclass(frozen=True, eq=False)  # each is its own key where something is prepared for it
class Scene:
    """What is known of the body without any simulation.

    Attributes
    ----------
    points_mm
        (N, 2) float64, points of the undeformed face [mm].
    triangles
        (T, 3) int64, triangulation of the face on these points.
    clamp
        (C,) int64, points that are held fixed.
    max_kpa
        Highest pressure of interest [kPa].
    lame_mpa, shear_modulus_mpa
        Lamé's constants λ and μ at small strain [MPa].
    body_force_n_mm3
        Weight per undeformed volume along x and z [N/mm³].
    finger
        The finger, for losses that ask for its law or its profile; None for data of unknown origin.
    base
        (B,) int64, points of the base line from root to tip; None where it is not known.
    """

    points_mm: NDArray[np.float64]
    triangles: NDArray[np.int64]
    clamp: NDArray[np.int64]
    max_kpa: float
    lame_mpa: float
    shear_modulus_mpa: float
    body_force_n_mm3: tuple[float, float]
    finger: Finger | None = None
    base: NDArray[np.int64] | None = None

    @property
    def face(self) -> Face | None:
        """The face and its base line, as a surrogate keeps them."""
        return None if self.base is None else Face(FaceMesh(self.points_mm, self.triangles), self.base)

    @cached_property
    def outline(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Midpoints (S, 2) [mm] and outward unit normals (S, 2) of the edges of the face that are not clamped."""
        ends = np.concatenate([np.roll(self.triangles, -1 - c, axis=1)[:, :2] for c in range(3)])
        across = np.concatenate([self.triangles[:, c] for c in range(3)])
        _, first, uses = np.unique(np.sort(ends, axis=1), axis=0, return_index=True, return_counts=True)
        once = first[uses == 1]
        once = once[~np.isin(ends[once], self.clamp).all(axis=1)]
        start, stop = self.points_mm[ends[once, 0]], self.points_mm[ends[once, 1]]
        middle, along = (start + stop) / 2, stop - start
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
        inward = ((self.points_mm[across[once]] - middle) * normal).sum(axis=1) > 0
        return middle, np.where(inward[:, None], -normal, normal)

    @classmethod
    def of(cls, finger: Finger, snapshots: Snapshots) -> Scene:
        """The scene of `finger`, with the face that `snapshots` observe."""
        force_x, _, force_z = finger.body_force_n_mm3.tolist()
        return cls(
            points_mm=snapshots.points,
            triangles=snapshots.triangles,
            clamp=snapshots.clamp,
            max_kpa=float(snapshots.pressures_kpa[-1]),
            lame_mpa=finger.material.lame_mpa,
            shear_modulus_mpa=finger.material.shear_modulus_mpa,
            body_force_n_mm3=(force_x, force_z),
            finger=finger,
            base=snapshots.base,
        )
