"""The finger as a planar rod: milliseconds for each pressure."""

from dataclasses import dataclass

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger

CAUTION = (
    "fem=rod leaves out that walls stiffen and chambers swell, and does not know its own error: 1 to 13 % at the tip "
    "of the fingers here (benchmarks/rungs.py), more under loads beyond theirs."
)


@register("fem", "rod")
@dataclass(frozen=True)
class Rod(Fem):
    """Geometrically exact rod under weight and follower pressure, with stiffnesses from its segments.

    Each segment from gap to gap is solved once in three dimensions at small strain; only rotations are large. Walls
    that stiffen, chambers that swell and contact are left out. For fingers with a profile; there is no body to show.
    At half and full pressure the tip of the fingers here is 1 to 13 % off (benchmarks/rungs.py). A segment bends the
    same all along, as if all others were like it and bore the same moment. So short fingers are worse, also at small
    loads: under weight some 5 % with six segments, 3 to 10 % with four and up to 35 % with two; under pressure up to
    9 % with two, and with one the tip may be off by twice its way (benchmarks/short_fingers.py). With fewer than six it
    warns.

    Attributes
    ----------
    edge_mm
        Longest edge of the elements that the segments are solved with [mm]; up to 7 % more is let pass. Half of it
        halves each element.
    step_mm
        Longest element of the rod [mm].
    newton_mm
        An equilibrium is found when Newton's correction is below this [mm].
    interpolation_mm
        Largest error of snapshots that are interpolated between equilibria [mm].
    """

    edge_mm: float = 3.0
    step_mm: float = 1.0
    newton_mm: float = 1e-6
    interpolation_mm: float = 1e-5

    def __post_init__(self) -> None:
        for name in ("edge_mm", "step_mm", "newton_mm", "interpolation_mm"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"fem.{name} is {getattr(self, name)} mm; it must be above 0.")

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        from pgdl_lab.mechanics.finger_rod import FingerRod
        from pgdl_lab.mechanics.reduced import simulate

        tolerances = self.newton_mm, self.interpolation_mm
        return simulate(
            lambda it: FingerRod(it, self.edge_mm, self.step_mm), self, finger, observation, tolerances, CAUTION
        )
