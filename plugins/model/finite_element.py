"""Model `finite_element`: one linear least-squares fit, the yardstick for everything that learns longer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgdl_lab.core.registry import register
from pgdl_lab.learning.linear import LinearModel

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.separable import SeparableRegression


@register("model", "finite_element")
@dataclass(frozen=True)
class FiniteElement(LinearModel):
    """Linear finite elements on the body times Chebyshev polynomials in the pressure, smoothed; one solve.

    The weight of the smoothing rises by the same factor from each order to the next; nothing of it is learnt. Error
    bars come from random draws, scaled by fits without a part of the points and one without the highest pressures.
    """

    def learn(self, regression: SeparableRegression, training: Training) -> Mapping[str, Tensor]:
        import numpy as np

        from pgdl_lab.learning.pod import LEARNING_DRAWS, decompose

        draws = max(LEARNING_DRAWS, self.degree_on(training.scene.domain) + 1)
        return decompose(regression, regression.first_prior(), draws, np.random.default_rng(training.seed))
