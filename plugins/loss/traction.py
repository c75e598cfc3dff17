"""Loss `traction`: the free outer surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.registry import register
from pgdl_lab.learning.plane_loss import PlaneLoss

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene


@register("loss", "traction")
@dataclass(frozen=True)
class TractionLoss(PlaneLoss):
    """Mean over the outline of the face, but for the clamp, of |P N|² [MPa²]: nothing acts on the outer surfaces.

    The side walls close the cavities, so the outline has no wall under air pressure. P is that of the finger's own
    hyperelastic law at finite strain, as in loss yeoh; the clamp belongs to loss boundary.

    Its minimum, zero, lies at rest; the simulated displacement has 7.6e-4 MPa² on pneunet (mean over all pressures, as
    `residuals` of each run tells, with derivatives of quadratics that are fitted to it).
    """

    order: ClassVar[int] = 1
    unit: ClassVar[str] = "MPa²"

    weight: float = 1e-2

    def own_points(self, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Midpoints of the outline's edges; no displacement is prescribed there."""
        middles, _ = scene.outline
        return middles, np.zeros_like(middles)

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        return self.tractions(jet, scene).square().sum(dim=1).mean()

    def tractions(self, jet: Jet, scene: Scene) -> Tensor:
        """P N (n, 2) [MPa] at the midpoints of the outline's edges."""
        law = self.law(scene.finger)
        _, normals = scene.outline
        return (law.stress(jet.gradient) * jet.rows.new_tensor(normals)[:, None]).sum(dim=2)
