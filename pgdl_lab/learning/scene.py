"""What is known of a body without any simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.domain import Domain
from pgdl_lab.mechanics.finger import Finger


@dataclass(frozen=True, eq=False)  # each is its own key where something is prepared for it
class Scene:
    """What is known of the body without any simulation.

    Attributes
    ----------
    domain
        The undeformed face: its points, a triangulation of them, the base line and the clamp.
    max_kpa
        Highest pressure of interest [kPa].
    lame_mpa, shear_modulus_mpa
        Lamé's constants λ and μ at small strain [MPa].
    body_force_n_mm3
        Weight per undeformed volume along x and z [N/mm³].
    finger
        The finger, for losses that ask for its law or its profile; None for data of unknown origin.
    provenance
        How it was simulated, for losses that ask for its finite elements.
    """

    domain: Domain
    max_kpa: float
    lame_mpa: float
    shear_modulus_mpa: float
    body_force_n_mm3: tuple[float, float]
    finger: Finger | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def kept_domain(self) -> Domain | None:
        """The face as a surrogate keeps it; None where no base line is known, so that there is no tip."""
        return self.domain if len(self.domain.base) else None

    @cached_property
    def outline(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Midpoints (S, 2) [mm] and outward unit normals (S, 2) of the edges of the face that are not clamped."""
        ends = np.concatenate([np.roll(self.domain.cells, -1 - c, axis=1)[:, :2] for c in range(3)])
        across = np.concatenate([self.domain.cells[:, c] for c in range(3)])
        _, first, uses = np.unique(np.sort(ends, axis=1), axis=0, return_index=True, return_counts=True)
        once = first[uses == 1]
        once = once[~np.isin(ends[once], self.domain.clamp).all(axis=1)]
        start, stop = self.domain.points_mm[ends[once, 0]], self.domain.points_mm[ends[once, 1]]
        middle, along = (start + stop) / 2, stop - start
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
        inward = ((self.domain.points_mm[across[once]] - middle) * normal).sum(axis=1) > 0
        return middle, np.where(inward[:, None], -normal, normal)

    @classmethod
    def of(cls, finger: Finger, snapshots: Dataset) -> Scene:
        """The scene of `finger`, with the face that `snapshots` observe."""
        force_x, _, force_z = finger.body_force_n_mm3.tolist()
        return cls(
            domain=snapshots.domain,
            max_kpa=float(snapshots.pressures_kpa.max()),
            lame_mpa=finger.material.lame_mpa,
            shear_modulus_mpa=finger.material.shear_modulus_mpa,
            body_force_n_mm3=(force_x, force_z),
            finger=finger,
            provenance=snapshots.provenance,
        )
