"""Model `pod`: modes of the finger and of the pressure, learnt from scattered points, with error bars."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.learning.linear import LinearModel

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.separable import SeparableRegression


@register("model", "pod")
@dataclass(frozen=True)
class Pod(LinearModel):
    """Proper orthogonal decomposition from scattered points: how the field varies with the pressure is learnt too.

    Each round fits the field under a Gaussian prior and learns from it how strongly, and in which modes, fields of this
    finger vary with the pressure, and how far the data can be trusted. See `SeparableRegression`.

    Attributes
    ----------
    degree
        Degree of the polynomials in the pressure; null: 10 on the side face, 5 in a whole body, where each degree more
        costs much time.
    rounds
        How often the prior is learnt anew.
    draws
        Random draws that the error bars are found from.
    """

    on_face: ClassVar[int] = 10

    rounds: int = 4
    draws: int = 48

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rounds < 0:
            raise InputError(f"model.rounds is {self.rounds}; it must not be negative.")
        polynomials = (self.degree or self.on_face) + 1
        if self.draws < polynomials:
            raise InputError(
                f"model.draws is {self.draws}; as many as polynomials ({polynomials}) are needed to tell their "
                "errors apart."
            )

    def learn(self, regression: SeparableRegression, training: Training) -> Mapping[str, Tensor]:
        import numpy as np

        from pgdl_lab.learning.pod import decompose, learnt_prior

        rng = np.random.default_rng(training.seed)
        return decompose(regression, learnt_prior(regression, self.rounds, rng), self.draws, rng)
