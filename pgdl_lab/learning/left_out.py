"""How a network errs that has few points, or none in a stretch of the body: it is trained again without some."""

from __future__ import annotations

import itertools
import logging
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.learning.data import Training
from pgdl_lab.learning.fit import Trainable, trained_field
from pgdl_lab.learning.gaps import BLOCKS, Excess, Gap
from pgdl_lab.learning.module import TrainingDiverged
from pgdl_lab.learning.neural_surrogate import last_layer, ridge_of, scores_mm
from pgdl_lab.surrogate.calibration import FEWEST, Held, enough, wider
from pgdl_lab.surrogate.last_layer import LastLayer

if TYPE_CHECKING:
    from pgdl_lab.learning.field import ReadOutField

_log = logging.getLogger(__name__)

PARTS = 5
FEW = 10 * FEWEST  # of fewer points a tenth is too few to calibrate error bars on


def bars_left_out(model: Trainable, training: Training, field: ReadOutField, spent_s: float) -> LastLayer | None:
    """Error bars of a trained field, from networks that were trained without parts of the points where that is needed.

    It is needed where points set aside are too few, or cannot tell how the field errs: in a stretch of the body that
    has no training points, or between simulations, as those set aside are of the same ones. None, and a warning, where
    the time is not enough for it.

    Parameters
    ----------
    model, training, field
        What was trained.
    spent_s
        The time that it took [s]; so much is needed for each part, and all must fit into the budget.
    """
    whole, scene = training.whole, training.scene
    count, several = len(whole), len(np.unique(whole.cases.simulation)) > 1
    if not enough(whole.cases):
        return None
    gap = scene.kept_domain and Gap.left_by(whole.points_mm, scene.domain.points_mm, scene.domain.points_mm[:0])
    parts = PARTS if count < FEW or several else 0
    needed_s = (1 + parts + (BLOCKS if gap else 0)) * spent_s
    if needed_s > training.trainer.max_seconds:
        _log.warning(
            "There was no time to train without parts of the points, which tells how far the model errs, so it has no "
            "error bars: %sgive trainer.max_time %.0f s.",
            "" if several else f"train on {FEW} points or more, all over the body, or ",
            np.ceil(needed_s + spent_s / 2),
        )  # fmt: skip
        return None
    with tempfile.TemporaryDirectory() as folder:
        try:
            scores = scores_left_out(model, training, field, Path(folder)) if parts else None
            bars = last_layer(field, training.samples, training.held, scores)
            if bars is not None and scores is not None and several:
                told = np.interp(whole.cases.values[:, 0], bars.kpa, bars.bar_mm)[:, None]
                apart = [(scores / told)[part] for part in whole.cases.simulations]
                bars = replace(bars, bar_mm=bars.bar_mm * wider(apart))
            if not gap or bars is None:
                return bars
            stretch = gap.stretch(whole.points_mm, _excess(model, training, field, bars, Path(folder)))
        except TrainingDiverged:
            return None
    return None if stretch is None else replace(bars, stretch=stretch)


def scores_left_out(model: Trainable, training: Training, field: Any, folder: Path) -> NDArray[np.float64] | None:
    """Scores (n, 2) [mm], see `scores_mm`, at all points of a training, of networks that were trained without each."""
    whole, rng = training.whole, np.random.default_rng(training.seed)
    scores, rho = np.empty(whole.displacements_mm.shape), ridge_of(field, training.samples)
    known, simulation = np.unique(whole.cases.simulation, return_inverse=True)
    part = rng.permutation(len(known))[simulation] % PARTS if len(known) > 1 else rng.permutation(len(whole)) % PARTS
    for number in np.unique(part):
        out = part == number
        scores[out] = _scores_without(model, training, out, out, rho, folder / str(number))
    return scores if np.isfinite(scores).all() else None


def _excess(model: Trainable, training: Training, field: Any, bars: LastLayer, folder: Path) -> Excess:
    rho, numbers = ridge_of(field, training.samples), itertools.count()

    def excess(held: Held, judged: Held) -> NDArray[np.float64]:
        scores = _scores_without(model, training, held, judged, rho, folder / f"block{next(numbers)}")
        return scores / np.interp(training.whole.cases.values[judged, 0], bars.kpa, bars.bar_mm)[:, None]

    return excess


def _scores_without(
    model: Trainable, training: Training, out: Held, judged: Held, rho: float, folder: Path
) -> NDArray[np.float64]:
    """Scores (m, 2) [mm] of a network that is trained without the points `out` (n,), at the `judged` (n,)."""
    whole = training.whole
    without = Training.of(
        whole.at(~out), training.scene, training.losses, replace(training.trainer, progress=False), training.optimizer,
        training.seed, folder, {}, balancing=training.balancing,
    )  # fmt: skip
    field: Any = trained_field(model, without)
    return scores_mm(field, without.samples, whole.at(judged), rho)
