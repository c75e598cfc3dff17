"""What of a simulation is observed: how many pressures, and of the side face or of the whole body."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases

FACE, BODY = "face", "body"


@dataclass(frozen=True)
class Observation:
    """What of a simulation is kept.

    Attributes
    ----------
    snapshots
        Number of equal pressure sub-steps from zero (excluded) to the highest pressure (included).
    points
        Number of points of the side face.
    of
        "face" or "body": x and z of the side face, or x, y and z of all nodes of the mesh. One simulation serves both.
    """

    snapshots: int = 100
    points: int = 4439
    of: str = FACE

    def __post_init__(self) -> None:
        if self.snapshots < 1:
            raise InputError(f"observation.snapshots is {self.snapshots}; at least 1 pressure must be observed.")
        if self.points < 4:
            raise InputError(f"observation.points is {self.points}; at least 4 points are needed to cover a face.")

        if self.of not in (FACE, BODY):
            raise InputError(f"observation.of is '{self.of}'; it must be {FACE} or {BODY}.")

    def require_face(self, task: str) -> None:
        """Check that the side face is observed; raises InputError."""
        if self.of != FACE:
            raise InputError(f"{task} looks at the side face alone: leave out observation.of={self.of}.")

    def cases(self, max_kpa: float) -> Cases:
        """Observed cases of one simulation up to and including `max_kpa` [kPa]."""
        return Cases.path(self.pressures_kpa(max_kpa))

    def pressures_kpa(self, max_kpa: float) -> NDArray[np.float64]:
        """Observed pressures (P,) [kPa] up to and including `max_kpa` [kPa]."""
        return max_kpa * np.arange(1, self.snapshots + 1) / self.snapshots
