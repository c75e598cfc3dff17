"""The dataset: displacements of the side face at rising pressures."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Observation:
    """What of a simulation is kept.

    Attributes
    ----------
    snapshots
        Number of equal pressure sub-steps from zero (excluded) to the highest pressure (included).
    points
        Number of points of the side face.
    """

    snapshots: int = 100
    points: int = 4439


@dataclass(frozen=True)
class Snapshots:
    """Displacements of N points of the side face at P pressures.

    Attributes
    ----------
    points
        (N, 2) float64, x and z of the undeformed points [mm].
    triangles
        (T, 3) int64, a triangulation of the undeformed face on these points.
    base
        (B,) int64, points of the base line, ordered from the root to the tip.
    clamp
        (C,) int64, points that are held fixed.
    pressures_kpa
        (P,) float64, rising [kPa].
    displacements
        (P, N, 2) float64, u_x and u_z [mm].
    provenance
        Finger, mesh, material, solver, versions: everything needed to say where the numbers come from (JSON types only).
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    base: NDArray[np.int64]
    clamp: NDArray[np.int64]
    pressures_kpa: NDArray[np.float64]
    displacements: NDArray[np.float64]
    provenance: dict[str, Any] = field(default_factory=dict)
