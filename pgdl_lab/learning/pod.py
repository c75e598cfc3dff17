"""Proper orthogonal decomposition of a field from scattered points, with error bars."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from pgdl_lab.learning.calibration import Floats, Held, bar_deviations
from pgdl_lab.learning.separable import Prior, SeparableRegression

LEARNING_DRAWS = 16  # random draws for what is averaged over the whole body


def learnt_prior(regression: SeparableRegression, rounds: int, rng: np.random.Generator) -> Prior:
    """The prior that is learnt from the data in `rounds` rounds."""
    prior = regression.first_prior()
    for _ in range(rounds):
        prior = regression.learnt(regression.posterior(prior, LEARNING_DRAWS, rng))
    return prior


def decompose(
    regression: SeparableRegression, prior: Prior, draws: int, rng: np.random.Generator
) -> Mapping[str, Tensor]:
    """What the state of a `NodalSurrogate` holds beside the body.

    Parameters
    ----------
    regression
        The data and the body.
    prior
        What is assumed of the field.
    draws
        Random draws that the error bars are found from, at least as many as polynomials.
    rng
        Where they are drawn from.
    """
    posterior = regression.posterior(prior, draws, rng)

    def ratios(held: Held) -> Floats:
        mean, deviation = regression.at_samples(regression.posterior(prior, LEARNING_DRAWS, rng, kept=~held))
        expected_mm = np.sqrt((deviation[held] ** 2).mean(axis=1) + prior.noise_mm**2)
        return np.abs(mean - regression.samples.displacements_mm)[held] / expected_mm[:, None]

    bar_kpa, deviations = bar_deviations(regression.samples.pressures_kpa, ratios, rng)
    # with draws = Q R, the covariance is Rᵀ R
    _, spread = np.linalg.qr(posterior.draws.transpose(0, 2, 1) / np.sqrt(draws))
    return {
        "modes": torch.from_numpy(posterior.modes.copy()),
        "amplitudes": torch.from_numpy(prior.amplitudes.copy()),
        "spread": torch.from_numpy(spread.transpose(0, 2, 1).astype(np.float32)),
        "noise_mm": torch.tensor(prior.noise_mm),
        "bar_kpa": torch.from_numpy(bar_kpa),
        "bar_deviations": torch.from_numpy(deviations),
    }
