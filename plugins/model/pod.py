"""Model `pod`: modes of the finger and of the pressure, learnt from scattered points, with error bars."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgdl_lab.errors import InputError
from pgdl_lab.learning.linear import LinearModel
from pgdl_lab.registry import register

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.separable import SeparableRegression

LEARNING_DRAWS = 16  # random draws for what is averaged over the whole body


@register("model", "pod")
@dataclass(frozen=True)
class Pod(LinearModel):
    """Proper orthogonal decomposition from scattered points: how the field varies with the pressure is learnt too.

    Each round fits the field under a Gaussian prior and learns from it how strongly, and in which modes, fields of this
    finger vary with the pressure, and how far the data can be trusted. See `SeparableRegression`.

    Attributes
    ----------
    rounds
        How often the prior is learnt anew.
    draws
        Random draws that the error bars are found from.
    """

    degree: int = 10
    rounds: int = 4
    draws: int = 48

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rounds < 0:
            raise InputError(f"model.rounds is {self.rounds}; it must not be negative.")
        if self.draws < self.degree + 1:
            raise InputError(
                f"model.draws is {self.draws}; as many as polynomials ({self.degree + 1}) are needed to tell their "
                "errors apart."
            )

    def learn(self, regression: SeparableRegression, training: Training) -> Mapping[str, Tensor]:
        import numpy as np
        import torch

        from pgdl_lab.learning.calibration import bar_deviations

        rng = np.random.default_rng(training.seed)
        prior = regression.first_prior()
        for _ in range(self.rounds):
            prior = regression.learnt(regression.posterior(prior, LEARNING_DRAWS, rng))
        posterior = regression.posterior(prior, self.draws, rng)
        bar_kpa, deviations = bar_deviations(regression, prior, LEARNING_DRAWS, rng)
        # with draws = Q R, the covariance is Rᵀ R
        _, spread = np.linalg.qr(posterior.draws.transpose(0, 2, 1) / np.sqrt(self.draws))
        return {
            "modes": torch.from_numpy(posterior.modes.copy()),
            "amplitudes": torch.from_numpy(prior.amplitudes.copy()),
            "spread": torch.from_numpy(spread.transpose(0, 2, 1).astype(np.float32)),
            "noise_mm": torch.tensor(prior.noise_mm),
            "bar_kpa": torch.from_numpy(bar_kpa),
            "bar_deviations": torch.from_numpy(deviations),
        }
