"""How many standard deviations an error bar must have, from samples that are held out of a fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

COVERED = 0.95  # share of the errors that a bar covers
NORMAL = 1.96  # standard deviations that cover this share of a normal distribution, where nothing can be held out
INSIDE = 0.1  # share of the samples that is held out to calibrate bars within the trained pressures
ABOVE = 0.12  # part of the trained pressures that is held out, from the top, to calibrate bars beyond them
FARTHEST = 0.96  # of the highest, from where on those held out above count: errors outgrow their bars with the distance

Floats = NDArray[np.float64]
Held = NDArray[np.bool_]

Ratios = Callable[[Held, Held], Floats]
"""|error| by its expected size (m, 2): of a fit without the samples held out (n,), at some (n,) of them."""


def bar_deviations(pressures_kpa: Floats, ratios: Ratios, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Pressures (2,) [kPa] and the number of standard deviations (2,) that covers 95 % of the errors there.

    The first is the highest trained pressure and stands for all below, the second stands for all above. Bars are never
    narrower beyond the trained pressures than within.

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
    some = rng.random(len(pressures_kpa)) < INSIDE
    top = pressures_kpa > (1 - ABOVE) * highest
    inside, above = _quantile(ratios, some, some), _quantile(ratios, top, top & (pressures_kpa >= highest * FARTHEST))
    return np.array([highest, (1 + ABOVE) * highest]), np.array([inside, max(inside, above)])


def _quantile(ratios: Ratios, held: Held, judged: Held) -> float:
    return NORMAL if held.all() or not held.any() else float(np.quantile(ratios(held, judged), COVERED))
