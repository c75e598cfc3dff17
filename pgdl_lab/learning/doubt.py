"""What a training can tell of itself: not learnt its data, followed their noise, or seen only part of a body.

A small error at the training points proves nothing, but a large one proves that the model is wrong; and where no point
was shown, nothing was learnt.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.heard import WARNINGS, heard
from pgdl_lab.core.simplices import place
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.in_space import require_in_plane, require_in_space, require_inputs
from pgdl_lab.learning.model import Model
from pgdl_lab.surrogate.calibration import NORMAL
from pgdl_lab.surrogate.surrogate import Surrogate

_log = logging.getLogger(__name__)

UNLEARNT = 0.05  # root mean square error at the training points, of that of the displacement
HOLE = 0.08  # distance from the nearest training point, of the largest extent of the body
LOOKED_AT = 2000  # training points at most; finding out costs little beside the training


def trained(model: Model, training: Training) -> Surrogate:
    """Fit `model` and warn of what speaks against the result, which keeps it beside the warnings of its data.

    Raises
    ------
    InputError, TrainingDiverged
        See `Model.fit`.
    """
    require_inputs(model, training.whole.cases)
    if training.scene.domain.is_body:
        require_in_space(model, training.losses)
    else:
        require_in_plane(training.losses)
    with heard() as sentences:
        surrogate = model.fit(training)
        _doubt(surrogate, training)
    surrogate.record.provenance[WARNINGS] = [*surrogate.warnings, *sentences]
    return surrogate


def _doubt(surrogate: Surrogate, training: Training) -> None:
    samples, some = training.samples, np.random.default_rng(0).permutation(len(training.samples))
    _warn_of_holes(surrogate, training)
    error = _relative_error(surrogate, samples, some[:LOOKED_AT])
    if not error <= UNLEARNT:
        _log.warning(
            "The model has not learnt its own training points: it errs by %.2g %% of the displacement there; train it "
            "longer, or with another learning rate, weights or model.",
            100 * error,
        )
    else:
        _warn_of_noise(surrogate, samples, some[:LOOKED_AT])


def _warn_of_noise(surrogate: Surrogate, samples: Samples, some: NDArray[np.int64]) -> None:
    """A model that follows the noise of its data is far from those that its error bars are calibrated on."""
    bars = surrogate.bars(samples.points_mm[some], _highest(samples))
    size = _size(samples.displacements_mm)
    if bars is not None and np.median(bars) > UNLEARNT * size:
        _log.warning(
            "The model's own error bars are %.2g %% of the displacement: its data are too few or too noisy for it.",
            100 * np.median(bars) / size,
        )


def _warn_of_holes(surrogate: Surrogate, training: Training) -> None:
    """A place far from all training points and from the clamp, if the error bars there are wide or there are none."""
    from scipy.spatial import cKDTree

    scene, samples = training.scene, training.whole
    body = scene.domain.points_mm
    distance, _ = cKDTree(np.concatenate([samples.points_mm, body[scene.domain.clamp]])).query(body)
    far = distance > HOLE * float(np.ptp(body, axis=0).max())
    if not far.any():
        return
    highest = _highest(samples)
    bars_mm = surrogate.bars(body[far], highest)
    if bars_mm is None:
        told = "what the model says there is a guess"
    else:
        expected = _size(bars_mm) / NORMAL / _size(surrogate.probe(body).values(highest))
        if expected < UNLEARNT:
            return
        told = f"by its own error bars the model errs by some {100 * expected:.2g} % of the displacement there"
    _log.warning(
        "No training point lies within %.2g mm of %s: %s; train on more points, or on some there.",
        distance.max(), place(body[distance.argmax()], ".3"), told,
    )  # fmt: skip


def _highest(samples: Samples) -> NDArray[np.float64]:
    """The case, alone, that goes farthest along the first input."""
    return samples.cases.asked[[samples.cases.values[:, 0].argmax()]]


def _size(vectors_mm: NDArray[np.float64]) -> float:
    return float(np.sqrt((vectors_mm**2).mean()))


def _relative_error(surrogate: Surrogate, samples: Samples, some: NDArray[np.int64]) -> float:
    """Root mean square error at the samples `some` (n,), relative to that of their displacement."""
    chosen, squares = samples.at(some), 0.0
    cases, number = np.unique(chosen.cases.asked, axis=0, return_inverse=True)
    for i, case in enumerate(cases):
        here = number == i
        error = surrogate.probe(chosen.points_mm[here]).values(case[None])[0] - chosen.displacements_mm[here]
        squares += float((error**2).sum())
    size = float((chosen.displacements_mm**2).sum())
    return float(np.sqrt(squares / size)) if size else np.inf
