"""How many standard deviations an error bar must have, from samples that are held out of a fit."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.inputs import Cases

COVERED = 0.95  # share of the errors that a bar covers
NORMAL = 1.96  # standard deviations that cover this share of a normal distribution
FOLDS = 10  # parts of the samples that are held out in turn to calibrate bars within the trained pressures ...
JUDGED = 100  # ... until so many samples were
FEWEST = 19  # samples that tell what 95 % of others lie below, whatever they look like
SIMULATIONS = 3  # of several, the fewest that tell by leaving out each what lies between them
STEEPEST = 0.3  # mean size of errors at no pressure, by that at the highest, at least
ABOVE = 0.12  # part of the trained pressures that is held out, from the top, to calibrate bars beyond them
FARTHEST = 0.96  # of the highest, from where on those held out above count: errors outgrow their bars with the distance

TOO_FEW = "%d points are too few to tell how far the model errs, so it has no error bars: train on %d points at least."

_log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Held = NDArray[np.bool_]

Ratios = Callable[[Held, Held], Floats]
"""|error| by its expected size (m, 2): of a fit without the samples held out (n,), at some (n,) of them, in order."""


def bar_deviations(cases: Cases, ratios: Ratios, rng: np.random.Generator) -> tuple[Floats, Floats] | None:
    """How far along (3,), see `limits.along`, and how many standard deviations (3,) cover 95 % of the errors there.

    It is linear up to the highest trained pressure, and the last stands for all above and for other inputs outside.
    Bars are never narrower there than within. Of many samples a tenth is held out, of few all are, in turn; of several
    simulations these as a whole, as no sample tells how a model errs between them that knows others of the same. Of
    too few, see `enough`, nothing is told: None.

    Parameters
    ----------
    cases
        Those of the samples.
    ratios
        Fits without some of the samples and looks at those.
    rng
        Chooses which.
    """
    if not enough(cases):
        return None
    first = cases.values[:, 0]
    highest = float(first.max())
    folds, (top, at_the_top) = inside_folds(cases, rng), above_fold(cases)
    found = [ratios(mask, mask) for mask in folds]
    shares = [first[mask] / highest for mask in folds]
    lowest, inside = covering_line(np.concatenate(shares), np.concatenate(found))
    if len(np.unique(cases.simulation)) > 1 and inside:
        told = [np.interp(share, [0, 1], [lowest, inside])[:, None] for share in shares]
        more = wider([part / bar for part, bar in zip(found, told, strict=True)])
        lowest, inside = more * lowest, more * inside
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


def enough(cases: Cases) -> bool:
    """Whether samples in these cases tell how far a model errs; if not, that is said."""
    simulations = len(np.unique(cases.simulation))
    if 1 < simulations < SIMULATIONS:
        _log.warning(
            "%d simulations are too few to tell how far the model errs between them, so it has no error bars: join %d "
            "at least.", simulations, SIMULATIONS,
        )  # fmt: skip
        return False
    if len(cases) < FEWEST:
        _log.warning(TOO_FEW, len(cases), FEWEST)
        return False
    return True


def wider(parts: Sequence[Floats]) -> float:
    """How many times wider than told bars must be, at least once, for |errors| (m, 2) by their bars in some parts.

    The errors in one part, a stretch of the body or a simulation, rise and fall together, so that each counts once: by
    what covers 95 % of it.
    """
    return max(1.0, covering(np.array([[np.quantile(part, COVERED)] for part in parts])))


def inside_folds(cases: Cases, rng: np.random.Generator) -> list[Held]:
    """Masks (n,) of parts of the samples to be held out in turn, drawn at random; of several simulations whole ones."""
    count, known = len(cases), np.unique(cases.simulation)
    if len(known) > 1:
        groups = np.array_split(rng.permutation(known), min(FOLDS, len(known)))
        return [np.isin(cases.simulation, group) for group in groups]
    parts = [part for part in np.array_split(rng.permutation(count), FOLDS) if 0 < len(part) < count]
    return [np.isin(np.arange(count), part) for part in parts[: fits(cases) - 1]]


def above_fold(cases: Cases) -> tuple[Held, Held]:
    """Masks (n,) of the samples to be held out at the top of the first input, and of those that are judged there."""
    first = cases.values[:, 0]
    highest = first.max()
    top = first > (1 - ABOVE) * highest
    return top, top & (first >= highest * FARTHEST)


def fits(cases: Cases) -> int:
    """How many fits the bars of a model with samples in these cases are calibrated by."""
    count, known = len(cases), len(np.unique(cases.simulation))
    return (min(FOLDS, known) if known > 1 else min(FOLDS, count, -(-JUDGED * FOLDS // count))) + 1


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
