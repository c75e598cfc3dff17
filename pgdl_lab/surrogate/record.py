"""What a surrogate remembers of its training."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.face_mesh import FaceMesh


@dataclass(frozen=True)
class Face:
    """The side face that a surrogate is a field on.

    Attributes
    ----------
    mesh
        The undeformed face.
    base
        (B,) int64, points of the base line, from the root to the tip.
    """

    mesh: FaceMesh
    base: NDArray[np.int64]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What a file holds of it."""
        return {**asdict(self.mesh), "base": self.base}


@dataclass(frozen=True)
class Record:
    """What a surrogate remembers of its training (JSON types, but for the face).

    Attributes
    ----------
    ranges
        Least and greatest training value: "x_mm", "z_mm" and "pressure_kpa".
    provenance
        Where the training data come from; "warnings" are sentences on what may be wrong with them and with the
        training.
    history
        Entries of the loss history: "epoch", "seconds", "lr", "raw/<loss>", "weighted/<loss>", "share/<loss>".
    face
        The side face; None if it is not known, so that nobody can tell what lies off the body.
    """

    ranges: dict[str, list[float]]
    provenance: dict[str, Any]
    history: list[dict[str, float]] = field(default_factory=list)
    face: Face | None = field(default=None, compare=False)

    @property
    def provenance_hash(self) -> str:
        """SHA-256 of the provenance."""
        return hashlib.sha256(json.dumps(self.provenance, sort_keys=True).encode()).hexdigest()
