"""The finger as a plane body: its x–z section."""

from dataclasses import dataclass, replace

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger

CAUTION = (
    "fem=section was calibrated on finger=pneunet and does not know its own error, which can be tens of per cent on "
    "other fingers (benchmarks/rungs.py)."
)


@register("fem", "section")
@dataclass(frozen=True)
class Section(Fem):
    """A section at finite strain, with a layer across the cavities for the side walls; follower pressure and weight.

    A calibrated model: for each state one share of the side walls, the one with the least mean error of the tip on
    finger=pneunet over all pressures (plane stress: of 0.3, 0.4, 0.5; plane strain: of 0.05, 0.07, 0.09, 0.1, 0.11). It
    does not carry over to every finger (benchmarks/rungs.py). Contact is left out. For fingers with a profile; there is
    no body to show.

    Attributes
    ----------
    edge_mm
        Longest element edge [mm]; up to 7 % more is let pass. Half of it halves each element.
    state
        `plane_stress` or `plane_strain`, which is quicker and errs more.
    side_wall_share
        Share of the side walls' stiffness that counts over the cavities [–], at most 1; none: that of the state.
    newton_mm
        An equilibrium is found when Newton's correction is below this [mm].
    interpolation_mm
        Largest error of snapshots that are interpolated between equilibria [mm].
    """

    edge_mm: float = 3.0
    state: str = "plane_stress"
    side_wall_share: float | None = None
    newton_mm: float = 1e-6
    interpolation_mm: float = 1e-5

    def __post_init__(self) -> None:
        for name in ("edge_mm", "newton_mm", "interpolation_mm"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"fem.{name} is {getattr(self, name)} mm; it must be above 0.")
        if self.side_wall_share is not None and not 0 < self.side_wall_share <= 1:
            raise InputError(f"fem.side_wall_share is {self.side_wall_share}; it must be above 0 and at most 1.")
        from pgdl_lab.mechanics.section import STATES

        if self.state not in STATES:
            raise InputError(f"fem.state is '{self.state}'; choose one of {', '.join(STATES)}.")

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        from pgdl_lab.mechanics.reduced import simulate
        from pgdl_lab.mechanics.section import STATES, PlaneFinger

        state, tolerances = STATES[self.state], (self.newton_mm, self.interpolation_mm)
        if self.side_wall_share is not None:
            state = replace(state, side_wall_share=self.side_wall_share)
        return simulate(lambda it: PlaneFinger(it, self.edge_mm, state), self, finger, observation, tolerances, CAUTION)
