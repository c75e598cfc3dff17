"""Loss `boundary`: the clamp at the root."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.learning.loss import Loss

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene


@register("loss", "boundary")
@dataclass(frozen=True)
class BoundaryLoss(Loss):
    """Mean over the clamped points, u = 0 at x = 0, of the squared displacement [mm²].

    Its minimum, zero, lies at the simulated displacement, and at all others that are held there.
    """

    unit: ClassVar[str] = "mm²"
    in_space: ClassVar[bool] = True

    def own_points(self, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        clamped = scene.domain.points_mm[scene.domain.clamp]
        if not len(clamped):
            raise InputError("Loss boundary needs clamped points, but the snapshots name none; leave it out.")
        return clamped, np.zeros_like(clamped)

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        return (jet.value - target_mm).square().sum(dim=1).mean()
