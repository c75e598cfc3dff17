"""Loss `data`: the distance to the simulated displacements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.registry import register
from pgdl_lab.learning.loss import Loss

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene


@register("loss", "data")
@dataclass(frozen=True)
class DataLoss(Loss):
    """Mean over the training points of the squared error of all components [mm²] (paper, eq. 12).

    Its minimum, zero, lies at the simulated displacement.
    """

    unit: ClassVar[str] = "mm²"
    in_space: ClassVar[bool] = True

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        return (jet.value - target_mm).square().sum(dim=1).mean()
