"""Proper orthogonal decomposition of a field from scattered points, with error bars."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from pgdl_lab.learning.calibration import bar_deviations
from pgdl_lab.learning.separable import Prior, SeparableRegression

LEARNING_DRAWS = 16  # random draws for what is averaged over the whole body


def decompose(
    regression: SeparableRegression, rounds: int, draws: int, rng: np.random.Generator
) -> tuple[Prior, Mapping[str, Tensor]]:
    """The prior learnt in `rounds` rounds, and what the state of a `NodalSurrogate` holds beside the body.

    Parameters
    ----------
    regression
        The data and the body.
    rounds
        How often the prior is learnt anew.
    draws
        Random draws that the error bars are found from.
    rng
        Where they are drawn from.
    """
    prior = regression.first_prior()
    for _ in range(rounds):
        prior = regression.learnt(regression.posterior(prior, LEARNING_DRAWS, rng))
    posterior = regression.posterior(prior, draws, rng)
    bar_kpa, deviations = bar_deviations(regression, prior, LEARNING_DRAWS, rng)
    # with draws = Q R, the covariance is Rᵀ R
    _, spread = np.linalg.qr(posterior.draws.transpose(0, 2, 1) / np.sqrt(draws))
    return prior, {
        "modes": torch.from_numpy(posterior.modes.copy()),
        "amplitudes": torch.from_numpy(prior.amplitudes.copy()),
        "spread": torch.from_numpy(spread.transpose(0, 2, 1).astype(np.float32)),
        "noise_mm": torch.tensor(prior.noise_mm),
        "bar_kpa": torch.from_numpy(bar_kpa),
        "bar_deviations": torch.from_numpy(deviations),
    }
