"""The finger as a plane body: its x–z section."""

from dataclasses import dataclass

import numpy as np

from pgdl_lab.errors import InputError
from pgdl_lab.fem import Fem
from pgdl_lab.finger import Finger
from pgdl_lab.registry import register
from pgdl_lab.snapshots import Observation, Snapshots


@register("fem", "section")
@dataclass(frozen=True)
class Section(Fem):
    """Plane strain at finite strain, with a layer across the cavities for the side walls; follower pressure and weight.

    A calibrated model: of 0.03, 0.04, … 0.08 the share of the side walls has the least error on finger=pneunet over all
    pressures. It does not carry over to every finger: at full pressure the tip is 20 % off on pneunet and joints, but
    63 % on bellows (benchmarks/rungs.py); fem=rod is as fast and nearer. Contact is left out. For fingers with a
    profile; there is no body to show.

    Attributes
    ----------
    edge_mm
        Longest element edge [mm].
    side_wall_share
        Share of the side walls' stiffness that counts over the cavities [–], at most 1.
    newton_mm
        An equilibrium is found when Newton's correction is below this [mm].
    interpolation_mm
        Largest error of snapshots that are interpolated between equilibria [mm].
    """

    edge_mm: float = 3.0
    side_wall_share: float = 0.07
    newton_mm: float = 1e-6
    interpolation_mm: float = 1e-5

    def __post_init__(self) -> None:
        for name in ("edge_mm", "newton_mm", "interpolation_mm"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"fem.{name} is {getattr(self, name)} mm; it must be above 0.")
        if not 0 < self.side_wall_share <= 1:
            raise InputError(f"fem.side_wall_share is {self.side_wall_share}; it must be above 0 and at most 1.")

    def simulate(self, finger: Finger, observation: Observation) -> Snapshots:
        from pgdl_lab.mechanics.reduced import simulate
        from pgdl_lab.mechanics.section import PlaneFinger

        tolerances = self.newton_mm, self.interpolation_mm
        return simulate(
            lambda it: PlaneFinger(it, self.edge_mm, self.side_wall_share), self, finger, observation, tolerances
        )
