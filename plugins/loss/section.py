"""Loss `section`: the balance of forces on the x–z section, in weak form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.learning.plane_loss import PlaneLoss

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene
    from pgdl_lab.mechanics.finger import Finger


@register("loss", "section")
@dataclass(frozen=True)
class SectionLoss(PlaneLoss):
    """Mean square of the strain [–] that would balance weight, follower pressure and stress on the x–z section.

    Finite elements on the section, of the width of the finger, over cavities that of both side walls; see
    `pgdl_lab.learning.section_balance`. No derivative of the field is needed, so ReLU will do. The field is that of the
    side face and the section is not: chambers bulge between the side walls. So its minimum does not lie at the
    simulated displacement, which has 4.9e-3 on pneunet, more than no displacement at all, 4.1e-3 (means over all
    pressures; `residuals` of each run). Below its own floor this term can only do harm.

    Attributes
    ----------
    edge_mm
        Longest element edge [mm].
    side_wall_share
        Share of the side walls' stiffness that counts over the cavities [–], at most 1.
    """

    one_pressure: ClassVar[bool] = True
    unit: ClassVar[str] = "–"

    weight: float = 1e-4
    edge_mm: float = 6.0
    side_wall_share: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.edge_mm < np.inf:
            raise InputError(f"loss.section.edge_mm is {self.edge_mm} mm; it must be above 0.")
        if not 0 < self.side_wall_share <= 1:
            raise InputError(
                f"loss.section.side_wall_share is {self.side_wall_share}; it must be above 0 and at most 1."
            )

    def check(self, finger: Finger | None) -> None:
        from pgdl_lab.learning.section_balance import suited

        self.refuse_sideways_gravity(finger)
        suited(finger, self.state)

    def own_points(self, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Nodes of the elements; no displacement is prescribed there."""
        from pgdl_lab.learning.section_balance import section_balance

        points = section_balance(scene, self.state, self.edge_mm, self.side_wall_share).points_mm
        return points, np.zeros_like(points)

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        from pgdl_lab.learning.section_balance import section_balance

        balance = section_balance(scene, self.state, self.edge_mm, self.side_wall_share)
        assert jet.pressures_kpa is not None
        return balance.mean_square_strain(balance.forces(jet.value, 1e-3 * jet.pressures_kpa[0]))
