"""Stretches of a body that have no training points, and how much farther than expected a model errs there.

Samples that are held out at random come from the same places as the training points: they cannot tell how a model errs
in a stretch that has none. So stretches that do have some are held out, of the shape of the gap (D. Roberts et al.,
Cross-validation strategies for data with temporal, spatial, hierarchical, or phylogenetic structure, 2017).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.simplices import place
from pgdl_lab.learning.data import Samples
from pgdl_lab.surrogate.calibration import Held, Ratios, bar_deviations, wider

_log = logging.getLogger(__name__)

Floats = NDArray[np.float64]

USUAL = 0.99  # share of the training places that are nearer than usual to the next one
DEEP = 1.5  # a gap reaches so many times farther from training places than is usual among them ...
WIDE = 0.02  # ... and so much of the body lies farther from them than usual
BLOCKS, FEWEST = 5, 3  # stretches that are held out in turn, and the least that tell anything
STEP = 0.25  # of the width of a gap, by which it is moved along the body to hold out a stretch
KEPT = 0.5  # of the samples, at least

Excess = Callable[[Held, Held], Floats]
"""|error| by its error bar (m, k): of a fit without the samples held out (n,), at some (n,) of them, in order."""


@dataclass(frozen=True)
class Gap:
    """What lies farther from training points than is usual among them.

    Attributes
    ----------
    body_mm
        (N, d), points of the body [mm].
    known_mm
        (C, d), those of them that a model holds exactly [mm].
    distance_mm
        (N,), of each from the nearest training point or known one [mm].
    usual_mm
        What is usual among training points [mm].
    """

    body_mm: Floats
    known_mm: Floats
    distance_mm: Floats
    usual_mm: float

    @classmethod
    def left_by(cls, samples_mm: Floats, body_mm: Floats, known_mm: Floats) -> Gap | None:
        """The gap that samples at (n, d) leave; None if there is none."""
        from scipy.spatial import cKDTree

        places = np.unique(samples_mm, axis=0)
        if len(places) < 2:
            return None
        usual = float(np.quantile(cKDTree(places).query(places, k=2)[0][:, 1], USUAL))
        distance, _ = cKDTree(np.concatenate([places, known_mm])).query(body_mm)
        is_gap = distance.max() > DEEP * usual and (distance > usual).mean() > WIDE
        return cls(body_mm, known_mm, distance, usual) if is_gap else None

    @property
    def far(self) -> Held:
        """Which points of the body (N,) lie in it."""
        return self.distance_mm > self.usual_mm

    def blocks(self, samples_mm: Floats) -> Iterator[tuple[Held, Held]]:
        """Samples (n,) to be held out in turn: where the gap would lie if it were moved along the body.

        Beside them those among them that are to be judged: as far from what remains as the gap is from all.
        """
        from scipy.spatial import cKDTree

        gap_mm, found = self.body_mm[self.far], 0
        width, length = np.ptp(gap_mm[:, 0]) + self.usual_mm, np.ptp(self.body_mm[:, 0])
        for number in range(1, int(length / (STEP * width)) + 1):
            for move_mm in (-STEP * number * width, STEP * number * width):
                held = cKDTree(gap_mm + move_mm * np.eye(gap_mm.shape[1])[0]).query(samples_mm)[0] <= self.usual_mm
                if not held.any() or held.mean() > 1 - KEPT:
                    continue
                left_mm = np.concatenate([samples_mm[~held], self.known_mm])
                distance = cKDTree(left_mm).query(samples_mm)[0]
                judged = held & (distance > self.usual_mm) & (distance <= self.distance_mm.max())
                if judged.any() and found < BLOCKS:
                    found += 1
                    yield held, judged

    def stretch(self, samples_mm: Floats, excess: Excess) -> Floats | None:
        """What error bars (N,) must be multiplied by in the gap, 1 outside; None, and a warning, if nothing tells."""
        parts = [excess(held, judged) for held, judged in self.blocks(samples_mm)]
        if len(parts) < FEWEST:
            _log.warning(
                "No training point lies within %.2g mm of %s, and too few lie elsewhere to tell how far the model errs "
                "there, so it has no error bars: train on some points there.",
                self.distance_mm.max(), place(self.body_mm[self.distance_mm.argmax()], ".3"),
            )  # fmt: skip
            return None
        return np.where(self.far, wider(parts), 1.0)


def calibrated(samples: Samples, ratios: Ratios, gap: Gap | None, rng: np.random.Generator) -> dict[str, Floats]:
    """What the state of a surrogate with standard deviations holds to make error bars of them; empty if nothing tells.

    "bar_kpa" and "bar_deviations", see `bar_deviations`, and where there is a gap "bar_stretch" (N,), see
    `Gap.stretch`.
    """
    found = bar_deviations(samples.cases, ratios, rng)
    if found is None:
        return {}
    bars = dict(zip(("bar_kpa", "bar_deviations"), found, strict=True))
    if gap is None:
        return bars

    def excess(held: Held, judged: Held) -> Floats:
        return ratios(held, judged) / np.interp(samples.cases.values[judged, 0], *found)[:, None]

    stretch = gap.stretch(samples.points_mm, excess)
    return {} if stretch is None else {**bars, "bar_stretch": stretch}
