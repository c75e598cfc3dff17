"""How many standard deviations an error bar must have, from samples that are held out of a fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

COVERED = 0.95  # share of the errors that a bar covers
NORMAL = 1.96  # standard deviations that cover this share of a normal distribution, where nothing can be held out
FOLDS = 10  # parts of the samples that are held out in turn to calibrate bars within the trained pressures ...
JUDGED = 100  # ... until so many samples were
FEWEST = 19  # samples that tell what 95 % of others lie below, whatever they look like
ABOVE = 0.12  # part of the trained pressures that is held out, from the top, to calibrate bars beyond them
FARTHEST = 0.96  # of the highest, from where on those held out above count: errors outgrow their bars with the distance

Floats = NDArray[np.float64]
Held = NDArray[np.bool_]

Ratios = Callable[[Held, Held], Floats]
"""|error| by its expected size (m, 2): of a fit without the samples held out (n,), at some (n,) of them."""


def bar_deviations(pressures_kpa: Floats, ratios: Ratios, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Pressures (2,) [kPa] and the number of standard deviations (2,) that covers 95 % of the errors there.

    The first is the highest trained pressure and stands for all below, the second stands for all above. Bars are never
    narrower beyond the trained pressures than within. Of many samples a tenth is held out, of few all are, in turn.

    Parameters
    ----------
    pressures_kpa
        (n,), of the samples [kPa].
    ratios
        Fits without some of the samples and looks at those.
    rng
        Chooses which.
    """
    highest = float(pressures_kpa.max())
    folds, (top, at_the_top) = inside_folds(len(pressures_kpa), rng), above_fold(pressures_kpa)
    inside = covering(np.concatenate([ratios(mask, mask) for mask in folds])) if folds else NORMAL
    above = inside if top.all() else covering(ratios(top, at_the_top))
    return np.array([highest, (1 + ABOVE) * highest]), np.array([inside, max(inside, above)])


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
