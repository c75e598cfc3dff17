"""What a surrogate remembers of its training."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from pgdl_lab.core.domain import Domain


@dataclass(frozen=True)
class Record:
    """What a surrogate remembers of its training (JSON types, but for the domain).

    Attributes
    ----------
    ranges
        Least and greatest training value: "x_mm", of a body "y_mm", "z_mm", and each input, as a rule
        "pressure_kpa" alone.
    provenance
        Where the training data come from; "warnings" are sentences on what may be wrong with them and with the
        training.
    history
        Entries of the loss history: "epoch", "seconds", "lr", "raw/<loss>", "weighted/<loss>", "share/<loss>".
    domain
        The side face or the whole body; None if it is not known, so that nobody can tell what lies off the body.
    """

    ranges: dict[str, list[float]]
    provenance: dict[str, Any]
    history: list[dict[str, float]] = field(default_factory=list)
    domain: Domain | None = field(default=None, compare=False)

    @property
    def provenance_hash(self) -> str:
        """SHA-256 of the provenance."""
        return hashlib.sha256(json.dumps(self.provenance, sort_keys=True).encode()).hexdigest()


def arrays_of(domain: Domain) -> dict[str, NDArray[Any]]:
    """What the file of a surrogate holds of its side face, or of its body and the tetrahedra that this is cut into."""
    return {"points_mm": domain.points_mm, "triangles": domain.mesh.simplices, "base": domain.base}
