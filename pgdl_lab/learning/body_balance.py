"""The balance of forces of a whole body, as a term that a training can make small."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.core.errors import InputError
from pgdl_lab.learning.scene import Scene
from pgdl_lab.mechanics.derived import Mechanics
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.residual import Residual
from pgdl_lab.mechanics.solid import InvertedElement

Floats = NDArray[np.float64]


class BodyBalance:
    """What the finite elements of a body leave out of balance.

    Parameters
    ----------
    model
        The finite elements.
    max_kpa
        Highest pressure of interest [kPa]; what it and the weight leave of the body at rest counts as 1.
    """

    def __init__(self, model: Model, max_kpa: float) -> None:
        self.model, self.residual = model, Residual(model.equilibrium)
        rest = np.zeros_like(model.discretisation.positions)
        self._unit = self.residual.size(self.residual.forces(rest, model.amplitudes(max_kpa)))

    def share(self, displacement_mm: Tensor, kpa: float) -> Tensor:
        """rᵀ K₀⁻¹ r [–] of the forces r that are out of balance at a displacement (N, 3) [mm] and a pressure [kPa].

        Where the displacement turns an element inside out, that of a half, a quarter … of it stands in.
        """
        apply: Any = _Share.apply
        share: Tensor = apply(displacement_mm, self, kpa)
        return share

    def evaluated(self, displacement: Floats, kpa: float, *, slope: bool) -> tuple[float, Floats | None]:
        """`share` and, if asked for, its derivative (N, 3) by the displacement [1/mm]."""
        amplitudes, part = self.model.amplitudes(kpa), 1.0
        while True:
            try:
                forces = self.residual.forces(part * displacement, amplitudes)
                break
            except InvertedElement:
                part /= 2
        moved = self.residual.compliance(forces)
        share = float((forces * moved).sum()) / self._unit
        if not slope:
            return share, None
        return share, 2 * part / self._unit * self.residual.backward(part * displacement, amplitudes, moved)


class _Share(torch.autograd.Function):
    """See `BodyBalance.share`: forward the forces, backward the stiffness times what they would move."""

    @staticmethod
    def forward(ctx: Any, displacement_mm: Tensor, balance: BodyBalance, kpa: float) -> Tensor:
        nodal = displacement_mm.detach().cpu().double().numpy()
        share, slope = balance.evaluated(nodal, kpa, slope=displacement_mm.requires_grad)
        if slope is not None:
            ctx.save_for_backward(torch.from_numpy(slope).to(displacement_mm))
        return displacement_mm.new_tensor(share)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_share: Tensor) -> tuple[Tensor, None, None]:
        (slope,) = ctx.saved_tensors
        return by_share * slope, None, None


@lru_cache(maxsize=4)
def body_balance(scene: Scene) -> BodyBalance:
    """That of the body of a scene.

    Raises
    ------
    InputError
        When it is not a whole body that fem=solid simulated, or surfaces touched in it.
    """
    if scene.provenance.get("contact", {}).get("acted"):
        raise InputError(
            "Loss equilibrium balances a body whose surfaces do not touch, and here they did: leave it out, or lower "
            "finger.max_kpa."
        )
    return BodyBalance(Mechanics.of(scene).model, scene.max_kpa)
