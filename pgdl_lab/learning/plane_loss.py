"""Loss terms that ask for the finger's own law in the plane of its face."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgdl_lab.core.errors import InputError
from pgdl_lab.learning.loss import PhysicsLoss

if TYPE_CHECKING:
    from pgdl_lab.learning.plane import PlaneLaw
    from pgdl_lab.mechanics.finger import Finger

STATES = ("plane_stress", "plane_strain")


@dataclass(frozen=True)
class PlaneLoss(PhysicsLoss):
    """A loss term of a hyperelastic law in the plane; see `PlaneLaw`.

    Attributes
    ----------
    state
        "plane_stress" (the stretch out of the plane is solved for) or "plane_strain".
    """

    state: str = "plane_stress"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.state not in STATES:
            raise InputError(f"loss.{self.name}.state is '{self.state}'; choose one of {', '.join(STATES)}.")

    def check(self, finger: Finger | None) -> None:
        self.refuse_sideways_gravity(finger)
        self.law(finger)

    def law(self, finger: Finger | None) -> PlaneLaw:
        """The law of `finger` in this state; raises InputError where it has none of the first invariant."""
        from pgdl_lab.learning.plane import PlaneLaw  # torch is imported only when it is needed

        return PlaneLaw.of(finger.material if finger else None, self.state, self.name)
