"""How many standard deviations an error bar must have, from samples that are held out of a fit."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

COVERED = 0.95  # share of the errors that a bar covers
NORMAL = 1.96  # standard deviations that cover this share of a normal distribution
FOLDS = 10  # parts of the samples that are held out in turn to calibrate bars within the trained pressures ...
JUDGED = 100  # ... until so many samples were
FEWEST = 19  # samples that tell what 95 % of others lie below, whatever they look like
STEEPEST = 0.3  # mean size of errors at no pressure, by that at the highest, at least
ABOVE = 0.12  # part of the trained pressures that is held out, from the top, to calibrate bars beyond them
FARTHEST = 0.96  # of the highest, from where on those held out above count: errors outgrow their bars with the distance

TOO_FEW = "%d points are too few to tell how far the model errs, so it has no error bars: train on %d points at least."

_log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Held = NDArray[np.bool_]

Ratios = Callable[[Held, Held], Floats]
"""|error| by its expected size (m, 2): of a fit without the samples held out (n,), at some (n,) of them, in order."""


def bar_deviations(pressures_kpa: Floats, ratios: Ratios, rng: np.random.Generator) -> tuple[Floats, Floats] | None:
    """Pressures (3,) [kPa] and the number of standard deviations (3,) that covers 95 % of the errors there.

    It is linear in the pressure up to the highest trained one, and the last stands for all above. Bars are never
    narrower beyond the trained pressures than within. Of many samples a tenth is held out, of few all are, in turn. Of
    fewer than `FEWEST` samples nothing is told: None.

    Parameters
    ----------
    pressures_kpa
        (n,), of the samples [kPa].
    ratios
        Fits without some of the samples and looks at those.
    rng
        Chooses which.
    """
    if len(pressures_kpa) < FEWEST:
        _log.warning(TOO_FEW, len(pressures_kpa), FEWEST)
        return None
    highest = float(pressures_kpa.max())
    folds, (top, at_the_top) = inside_folds(len(pressures_kpa), rng), above_fold(pressures_kpa)
    found = np.concatenate([ratios(mask, mask) for mask in folds])
    lowest, inside = covering_line(np.concatenate([pressures_kpa[mask] for mask in folds]) / highest, found)
    above = inside if top.all() else covering(ratios(top, at_the_top))
    return np.array([0.0, highest, (1 + ABOVE) * highest]), np.array([lowest, inside, max(inside, above)])


def covering_line(shares: Floats, ratios: Floats) -> Floats:
    """What 95 % of further samples lie below, see `covering`, at no pressure and at the highest (2,); linear between.

    Errors can outgrow what is expected of them as the pressure rises: their mean size is taken for linear, or for
    constant where it would fall.

    Parameters
    ----------
    shares
        (m,), pressures of the samples by the highest.
    ratios
        (m, 2), |error| there by its expected size.
    """
    line = np.full(2, ratios.mean())
    if np.ptp(shares):
        level, slope = np.linalg.lstsq(np.column_stack([np.ones_like(shares), shares]), ratios.mean(axis=1))[0]
        if slope > 0:
            line = np.array([max(level, STEEPEST * (level + slope)), level + slope])
    if not line.any():
        return line  # no sample errs at all
    return line * covering(ratios / np.interp(shares, [0, 1], line)[:, None])


def inside_folds(count: int, rng: np.random.Generator) -> list[Held]:
    """Masks (n,) of parts of `count` samples to be held out in turn, drawn at random."""
    parts = [part for part in np.array_split(rng.permutation(count), FOLDS) if 0 < len(part) < count]
    return [np.isin(np.arange(count), part) for part in parts[: fits(count) - 1]]


def above_fold(pressures_kpa: Floats) -> tuple[Held, Held]:
    """Masks (n,) of the samples to be held out at the top of the pressures, and of those that are judged there."""
    highest = pressures_kpa.max()
    top = pressures_kpa > (1 - ABOVE) * highest
    return top, top & (pressures_kpa >= highest * FARTHEST)


def fits(count: int) -> int:
    """How many fits the bars of a model with `count` samples are calibrated by."""
    return min(FOLDS, count, -(-JUDGED * FOLDS // count)) + 1


def covering(ratios: Floats) -> float:
    """What 95 % of further samples lie below if they are like these m, whose |error| by its expected size is (m, 2).

    It is the rank that leaves one of twenty above, counted among the m and the next one (V. Vovk et al., Algorithmic
    learning in a random world, 2005). Of fewer than `FEWEST` none is high enough: these are taken for draws from a
    normal distribution of unknown size, so that Student's t tells how far above their root mean square to go.
    """
    count = len(ratios)
    if count >= FEWEST:
        return float(np.quantile(ratios, COVERED * (1 + 1 / count)))
    from scipy.special import stdtrit  # imported here: surrogates are used where NumPy alone is installed

    size = float(np.sqrt((ratios**2).mean()))
    return max(float(ratios.max()), size * float(stdtrit(count, (1 + COVERED) / 2)))
