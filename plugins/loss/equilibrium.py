"""Loss `equilibrium`: the finite elements' own balance of forces on the whole body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.registry import register
from pgdl_lab.learning.loss import PhysicsLoss

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene


@register("loss", "equilibrium")
@dataclass(frozen=True)
class EquilibriumLoss(PhysicsLoss):
    """Work rᵀ K₀⁻¹ r of the forces r that are out of balance, by that of the body at rest under its highest pressure.

    r is what the finite elements that simulated the body have left over at the field's nodes, and K₀ their stiffness at
    rest; see `pgdl_lab.mechanics.residual`. So it is 1 for no displacement at all under the highest pressure, and its
    minimum, zero to the tolerance of the solver, lies at the simulated equilibria. Forward it costs the forces of all
    elements, backward their stiffness times a vector. Between equilibria the simulation itself is interpolated, which
    leaves a trace of it. `physics_body.py` of the benchmarks measures what it buys a network: nothing at any weight.
    """

    in_space: ClassVar[bool] = True
    in_plane: ClassVar[bool] = False
    one_pressure: ClassVar[bool] = True
    unit: ClassVar[str] = "–"

    weight: float = 1e-3

    def own_points(self, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Nodes of the elements; no displacement is prescribed there."""
        from pgdl_lab.learning.body_balance import body_balance

        body_balance(scene)  # refuses what has none
        return scene.domain.points_mm, np.zeros_like(scene.domain.points_mm)

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        from pgdl_lab.learning.body_balance import body_balance

        assert jet.pressures_kpa is not None
        return body_balance(scene).share(jet.value, float(jet.pressures_kpa[0]))
