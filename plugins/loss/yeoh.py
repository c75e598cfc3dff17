"""Loss `yeoh`: the residual of equilibrium at finite strain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.registry import register
from pgdl_lab.learning.plane_loss import PlaneLoss

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene


@register("loss", "yeoh")
@dataclass(frozen=True)
class YeohLoss(PlaneLoss):
    """Mean over the training points of |Div P + ρ₀ g|² [(N/mm³)²], P of the finger's own hyperelastic law.

    The law is that of the finger: Yeoh or any other of the first invariant. The side face is a free surface, σ e_y = 0,
    so plane stress holds on it, but it is not in balance by itself: the stress that the body behind exerts on it,
    ∂P_iy/∂y, is unknown and left out. So its minimum does not lie at the simulated displacement, which has
    3.2e-4 (N/mm³)² on pneunet, but near rest, 1.2e-10 (means over all pressures; `residuals` of each run).
    """

    order: ClassVar[int] = 2
    unit: ClassVar[str] = "(N/mm³)²"

    weight: float = 1e-4

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        return self.residuals(jet, scene).square().sum(dim=1).mean()

    def residuals(self, jet: Jet, scene: Scene) -> Tensor:
        """Div P + ρ₀ g (n, 2) [N/mm³]."""
        law = self.law(scene.finger)
        return law.divergence(jet.gradient, jet.hessian) + jet.rows.new_tensor(scene.body_force_n_mm3)
