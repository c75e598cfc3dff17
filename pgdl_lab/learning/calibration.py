"""How many standard deviations an error bar must have, from samples that are held out of a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.learning.separable import Prior, SeparableRegression

COVERED = 0.95  # share of the errors that a bar covers
NORMAL = 1.96  # standard deviations that cover this share of a normal distribution, where nothing can be held out
INSIDE = 0.1  # share of the samples that is held out to calibrate bars within the trained pressures
ABOVE = 0.12  # part of the trained pressures that is held out, from the top, to calibrate bars beyond them


def bar_deviations(
    regression: SeparableRegression, prior: Prior, draws: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pressures (2,) [kPa] and the number of standard deviations (2,) that covers 95 % of the errors there.

    The first is the highest trained pressure and stands for all below, the second stands for all above. Bars are never
    narrower beyond the trained pressures than within.
    """
    pressures = regression.samples.pressures_kpa
    highest = float(pressures.max())
    inside = _quantile(regression, prior, rng.random(len(pressures)) < INSIDE, draws, rng)
    above = _quantile(regression, prior, pressures > (1 - ABOVE) * highest, draws, rng)
    return np.array([highest, (1 + ABOVE) * highest]), np.array([inside, max(inside, above)])


def _quantile(
    regression: SeparableRegression, prior: Prior, held: NDArray[np.bool_], draws: int, rng: np.random.Generator
) -> float:
    """Quantile of |error| by its expected size over the samples that are `held` (n,) out."""
    if held.all() or not held.any():
        return NORMAL
    mean, deviation = regression.at_samples(regression.posterior(prior, draws, rng, kept=~held))
    expected_mm = np.sqrt((deviation[held] ** 2).mean(axis=1) + prior.noise_mm**2)
    error_mm = np.abs(mean - regression.samples.displacements_mm)[held]
    return float(np.quantile(error_mm / expected_mm[:, None], COVERED))
