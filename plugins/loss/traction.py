"""Loss `traction`: the free outer surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.errors import InputError
from pgdl_lab.loss import Loss
from pgdl_lab.registry import register

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.finger import Finger
    from pgdl_lab.learning.data import Scene
    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.plane import PlaneLaw

STATES = ("plane_stress", "plane_strain")


@register("loss", "traction")
@dataclass(frozen=True)
class Traction(Loss):
    """Mean over the outline of the face, but for the clamp, of |P N|² [MPa²]: nothing acts on the outer surfaces.

    The side walls close the cavities, so the outline has no wall under air pressure. P is that of the finger's own
    hyperelastic law at finite strain, as in loss yeoh; the clamp belongs to loss boundary.

    Attributes
    ----------
    state
        "plane_stress" (the stretch out of the plane is solved for) or "plane_strain".
    """

    order: ClassVar[int] = 1

    weight: float = 1e-2
    state: str = "plane_stress"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.state not in STATES:
            raise InputError(f"loss.traction.state is '{self.state}'; choose one of {', '.join(STATES)}.")

    def check(self, finger: Finger | None) -> None:
        self._law(finger)

    def _law(self, finger: Finger | None) -> PlaneLaw:
        from pgdl_lab.learning.plane import PlaneLaw

        return PlaneLaw.of(finger.material if finger else None, self.state, "traction")

    def own_points(self, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Midpoints of the outline's edges; no displacement is prescribed there."""
        middles, _ = scene.outline
        return middles, np.zeros_like(middles)

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        return self.tractions(jet, scene).square().sum(dim=1).mean()

    def tractions(self, jet: Jet, scene: Scene) -> Tensor:
        """P N (n, 2) [MPa] at the midpoints of the outline's edges."""
        law = self._law(scene.finger)
        _, normals = scene.outline
        return (law.stress(jet.gradient) * jet.rows.new_tensor(normals)[:, None]).sum(dim=2)
