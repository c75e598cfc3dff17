"""How a network errs that has few points: it is trained again without a part of them, for each part."""

from __future__ import annotations

import logging
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.learning.calibration import FEWEST
from pgdl_lab.learning.data import Training
from pgdl_lab.learning.fit import trained_field
from pgdl_lab.learning.module import TrainingDiverged
from pgdl_lab.learning.neural_surrogate import ridge_of, scores_mm

if TYPE_CHECKING:
    from pgdl_lab.learning.neural import TrainedModel

_log = logging.getLogger(__name__)

PARTS = 5
FEW = 10 * FEWEST  # of fewer points a tenth is too few to calibrate error bars on


def scores_left_out(model: TrainedModel, training: Training, field: Any, spent_s: float) -> NDArray[np.float64] | None:
    """Scores (n, 2) [mm], see `scores_mm`, at all points of a training, of networks that were trained without each.

    None where the points set aside are enough, or the time is not.

    Parameters
    ----------
    model, training, field
        What was trained, a `ReadOutField`.
    spent_s
        The time that it took [s]; so much is needed for each part, and all must fit into the budget.
    """
    whole, trainer = training.whole, training.trainer
    count = len(whole.pressures_kpa)
    if not 2 * PARTS <= count < FEW:
        return None
    if (PARTS + 1) * spent_s > trainer.max_seconds:
        _log.warning(
            "Error bars are calibrated on %d points that were set aside, which are too few to trust them: train on %d "
            "points or more, or give trainer.max_time %.0f s to train without parts of them too.",
            len(training.held.pressures_kpa), FEW, np.ceil((PARTS + 1.5) * spent_s),
        )  # fmt: skip
        return None
    scores, rho = np.empty((count, 2)), ridge_of(field, training.samples)
    part = np.random.default_rng(training.seed).permutation(count) % PARTS
    with tempfile.TemporaryDirectory() as folder:
        for number in range(PARTS):
            out = part == number
            without = Training.of(
                whole.at(~out), training.scene, training.losses, replace(trainer, progress=False), training.optimizer,
                training.seed, Path(folder) / str(number), {}, balancing=training.balancing,
            )  # fmt: skip
            try:
                field = trained_field(model, without)
            except TrainingDiverged:
                return None
            scores[out] = scores_mm(field, without.samples, whole.at(out), rho)
    return scores if np.isfinite(scores).all() else None
