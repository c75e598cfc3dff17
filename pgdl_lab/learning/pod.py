"""Proper orthogonal decomposition of a field from scattered points, with error bars."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from pgdl_lab.learning.gaps import BLOCKS, Gap, calibrated
from pgdl_lab.learning.linear import regression_of
from pgdl_lab.learning.separable import Posterior, Prior, SeparableRegression, evaluated
from pgdl_lab.surrogate.calibration import Floats, Held, above_fold, fits, inside_folds

if TYPE_CHECKING:
    from pgdl_lab.learning.data import Samples, Training
    from pgdl_lab.learning.guided import GuidedField

_log = logging.getLogger(__name__)

LEARNING_DRAWS = 16  # random draws for what is averaged over the whole body
DRAWS = 48  # random draws that error bars are found from


def closed_form(
    training: Training, degree: int, rounds: int, under: GuidedField | None = None, spent_s: float = 0.0
) -> dict[str, Tensor]:
    """The state of a `NodalSurrogate` that is fitted to all training points, not `compressed` yet.

    With `under` it is fitted to what that leaves of them, in the time that is left after `spent_s`.
    """
    rng = np.random.default_rng(training.seed)
    samples, refitted, rough = training.whole, None, None
    if under is not None:
        rough, below = under.guide.numpy(), under.nodal()
        samples, refitted = _left_by(under, below, samples)
    regression, body = regression_of(training, degree, samples, rough, spent_s)
    with closing(regression):
        state = {**body, **decompose(regression, learnt_prior(regression, rounds, rng), DRAWS, rng, refitted)}
    if under is not None:  # both in Chebyshev polynomials themselves
        above = torch.einsum("dk,nkc->ndc", state["amplitudes"], state["modes"])
        state |= {"modes": above + torch.from_numpy(below), "amplitudes": torch.eye(degree + 1).double()}
    return state


def network_gains(training: Training, degree: int, rounds: int, field: GuidedField, spent_s: float) -> bool:
    """Whether the closed form errs less on what the network leaves than on what its guide alone does.

    Both are fitted without parts of the samples and judged by the mean squared errors on those, and without the highest
    pressures and judged there. The network has to gain more by one than it loses by the other. Where there is no time
    to look, it is taken to gain.
    """
    logarithms: list[Floats] = []
    for each in (field, field.without_network()):
        rng = np.random.default_rng(training.seed)
        samples, refitted = _left_by(each, each.nodal(), training.whole)
        top, at_the_top = above_fold(samples.cases)
        folds = [] if top.all() else [(top, at_the_top)]
        parts = [[(held, held) for held in inside_folds(samples.cases, rng)], folds]
        regression, _ = regression_of(training, degree, samples, each.guide.numpy(), spent_s)
        with closing(regression):
            prior = learnt_prior(regression, rounds, rng)
            if not regression.allows(2 * fits(samples.cases)):
                return True
            errors = [
                np.concatenate([
                    (regression.at_samples(regression.posterior(prior, 1, rng, ~held, refitted(held)))[0]
                     - refitted(held))[judged] for held, judged in part
                ]) for part in parts if part
            ]  # fmt: skip
        logarithms.append(np.log([float((error**2).mean()) for error in errors]))
    return bool((logarithms[0] - logarithms[1]).sum() < 0)


def _left_by(field: GuidedField, nodal: Floats, samples: Samples) -> tuple[Samples, Callable[[Held], Floats]]:
    """What a field with `nodal` values leaves of the samples, and what it would leave if it had not seen some."""
    left_mm = samples.displacements_mm - evaluated(nodal, field.body, samples, float(field.range_kpa[1]))
    return replace(samples, displacements_mm=left_mm), lambda held: left_mm + field.shifts_mm(samples, ~held)


def learnt_prior(regression: SeparableRegression, rounds: int, rng: np.random.Generator) -> Prior:
    """The prior that is learnt from the data in `rounds` rounds, or fewer if there is no time for more."""
    prior, afterwards = regression.first_prior(), 1 + fits(regression.samples.cases)
    for _ in range(rounds):
        if not regression.allows(1 + afterwards):
            break
        prior = regression.learnt(regression.posterior(prior, LEARNING_DRAWS, rng))
    return prior


def decompose(
    regression: SeparableRegression,
    prior: Prior,
    draws: int,
    rng: np.random.Generator,
    refitted: Callable[[Held], Floats] | None = None,
) -> Mapping[str, Tensor]:
    """What the state of a `NodalSurrogate` holds beside the body, with a mode for each polynomial.

    If there is no time to calibrate error bars, there are none.

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
    refitted
        Where the data are what another fit leaves of the displacement: what that would leave (n, 2) [mm] if it had not
        seen the samples held out (n,). Error bars hold what it errs by too.
    """
    samples = regression.samples
    gap = Gap.left_by(samples.points_mm, regression.body_mm, regression.clamp_mm)
    calibrations = fits(samples.cases) + (BLOCKS if gap else 0)
    few = len(prior.covariance)  # as many as polynomials
    posterior = regression.posterior(prior, draws if regression.allows(1 + calibrations) else few, rng)

    def ratios(held: Held, judged: Held) -> Floats:
        targets_mm = refitted(held) if refitted else samples.displacements_mm
        mean, deviation = regression.at_samples(
            regression.posterior(prior, LEARNING_DRAWS, rng, kept=~held, targets_mm=targets_mm)
        )
        expected_mm = np.sqrt((deviation[judged] ** 2).mean(axis=1) + prior.noise_mm**2)
        return np.abs(mean - targets_mm)[judged] / expected_mm[:, None]

    if not regression.allows(calibrations):
        _log.warning("trainer.max_time left no time to calibrate error bars, so there are none: give it more.")
        return known(posterior)
    bars = calibrated(samples, ratios, gap, rng)
    return {**known(posterior), **{name: torch.from_numpy(array) for name, array in bars.items()}}


def known(posterior: Posterior) -> dict[str, Tensor]:
    """What the state of a `NodalSurrogate` holds of a field: the mean, and square roots of the covariance."""
    prior = posterior.prior
    # with draws = Q R, the covariance is Rᵀ R
    draws_mm = np.einsum("dk,nks->nsd", prior.amplitudes, posterior.draws)
    _, spread = np.linalg.qr(draws_mm / np.sqrt(draws_mm.shape[1]))
    return {
        "modes": torch.from_numpy(posterior.modes.copy()),
        "amplitudes": torch.from_numpy(prior.amplitudes.copy()),
        "spread": torch.from_numpy(spread.transpose(0, 2, 1).astype(np.float32)),
        "noise_mm": torch.tensor(prior.noise_mm),
    }
