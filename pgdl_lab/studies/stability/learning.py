"""Surrogates under stress: few or noisy points, precision, weights, learning rates, and questions beyond the data.

All learn from simulations of one short finger. Errors are over all points at the pressure in question that no model has
seen there, relative to the root mean square of the displacement there. What is wrong is found from where the errors
are: at the training points themselves, between them, or beyond their pressures.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.registry import field_names, names, plugin
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.doubt import HOLE, trained
from pgdl_lab.learning.neural import TrainedModel
from pgdl_lab.learning.scene import Scene
from pgdl_lab.running.composing import experiment
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.stability.outcome import COVERED, DATA, GOOD, RANGE, TRAINING, Bar, Heard, Result
from pgdl_lab.surrogate.surrogate import Surrogate

SHARE = 0.05  # of the points, where nothing else is said
TRAINED_KPA, TESTED_KPA = 44.0, (46.0, 50.0, 60.0, 75.0)  # of the paper's finger; scaled to the one here
SMALLEST_MM = 1e-12  # bar
LONGEST = "00:30:00"  # of one training, which ends by its updates long before


@dataclass(frozen=True)
class Stress:
    """A training of an axis and where it is tested.

    Attributes
    ----------
    axis, level
        What it is.
    data
        "smooth", or "touching" where contact sets in beyond the trained range.
    share
        Of the points in range that are trained on.
    noise
        Standard deviation of the noise on the displacements, relative to their root mean square.
    trained, tested
        Highest pressure of training and pressure of the test, of the highest simulated.
    hidden
        Part of the length from and to which no point is trained on.
    losses
        Names and weights of the loss terms.
    optimizer, model
        Fields of the optimiser and of the model.
    """

    axis: str
    level: str
    data: str = "smooth"
    share: float = SHARE
    noise: float = 0.0
    trained: float = 1.0
    tested: float = 1.0
    hidden: tuple[float, float] = (0.0, 0.0)
    losses: dict[str, float] = field(default_factory=lambda: {"data": 1.0})
    optimizer: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)


def stresses(quick: bool) -> Iterator[Stress]:
    """All trainings; the quick ones are the last but one of each axis."""

    def levels(*all_levels: Any) -> tuple[Any, ...]:
        return all_levels[-2:][:1] if quick else all_levels

    for share in levels(0.05, 0.01, 0.002, 0.0005):
        yield Stress("fewer points", f"{share:.2%}", share=share)
    for noise in levels(0.0, 0.01, 0.05):
        yield Stress("noise", f"{noise:.0%}", noise=noise)
    for dtype in levels("float32", "float64"):
        yield Stress("precision", dtype, model={"dtype": dtype})
    for power in levels(-4, -2, 0, 2, 4):
        yield Stress("loss weights", f"1e{power}", losses={"data": 1.0, "navier_cauchy": 10.0**power})
    for activation in levels("relu", "tanh"):
        losses = {"data": 1.0, "navier_cauchy": 1.0}
        yield Stress("second derivatives", activation, losses=losses, model={"activation": activation})
    for rate in levels(1e-4, 1e-3, 1e-2, 1e-1, 10.0):
        yield Stress("learning rate", f"{rate:g}", optimizer={"lr": rate})
    for kpa in levels(*TESTED_KPA):
        trained, tested = TRAINED_KPA / TESTED_KPA[-1], kpa / TESTED_KPA[-1]
        yield Stress("extrapolation", f"{TRAINED_KPA:g} to {kpa:g}", trained=trained, tested=tested)
    for trained in levels(1.0, 0.85, 0.6, 0.4):
        yield Stress("contact beyond training", f"trained to {trained:.0%}", data="touching", trained=trained)
    for width in levels(0.0, 0.2, 0.4):
        yield Stress("points missing", f"{width:.0%} of the length", hidden=(0.5 - width / 2, 0.5 + width / 2))


def models(stress: Stress) -> list[str]:
    """Names of the models that the stress reaches; the others would only repeat a trial."""
    found = [name for name in names("model") if stress.model.keys() <= set(field_names("model", name))]
    return [name for name in found if not stress.optimizer or issubclass(plugin("model", name), TrainedModel)]


def attempt(stress: Stress, name: str, data: Dataset, finger: Any, seed: int, updates: int, heard: Heard) -> Result:
    """Train and test; raises LabError where the model refuses or stops."""
    how = experiment([f"seed={seed}"])
    train = _points(stress, data, seed)
    samples = Samples.of(data, train)
    size = float(np.sqrt((samples.displacements_mm**2).mean()))
    noise = stress.noise * size * np.random.default_rng(seed).standard_normal(samples.displacements_mm.shape)
    samples = replace(samples, displacements_mm=samples.displacements_mm + noise)
    tested = int(np.abs(data.pressures_kpa - stress.tested * data.pressures_kpa[-1]).argmin())
    with heard, tempfile.TemporaryDirectory() as folder:
        training = Training.of(
            samples,
            Scene.of(finger, data),
            {loss: plugin("loss", loss)(weight=weight) for loss, weight in stress.losses.items()},
            _budget(how, len(train), updates),
            replace(how.optimizer, **stress.optimizer),
            seed,
            Path(folder),
            {},
        )
        surrogate = trained(plugin("model", name)(**stress.model), training)
        surrogate.predict(data.domain.points_mm, float(data.pressures_kpa[tested]))  # warns of what lies beyond
    surrogate.outside = "ignore"
    return judged(surrogate, data, train, training, tested)


def judged(surrogate: Surrogate, data: Dataset, train: NDArray[np.int64], training: Training, tested: int) -> Result:
    """What is wrong with a surrogate of a `training` on the points `train` of `data`, when asked at `tested`.

    Parameters
    ----------
    train
        (n,) index of each sample, see `Samples.of`.
    training
        What it was told of them, which may be noisy, and which of them were set aside.
    tested
        Index of the pressure.
    """
    unseen = np.ones(data.displacements.shape[:2], dtype=bool)
    unseen.reshape(-1)[train] = False
    errors, error = _errors(surrogate, data, tested, unseen[tested])
    kpa, highest = float(data.pressures_kpa[tested]), surrogate.trained_kpa()[1]
    within = int((data.pressures_kpa <= highest).sum()) - 1
    known = error if kpa <= highest else _errors(surrogate, data, within, unseen[within])[1]
    causes = []
    if kpa > highest and not error <= GOOD:
        causes.append(RANGE)
    if not known <= GOOD:
        causes.append(DATA if _misfit(surrogate, training.samples) <= GOOD else TRAINING)
    far = _far(data.domain.points_mm[unseen[tested]], training.whole.points_mm)
    guessed = (DATA,) if far.any() and _size(errors[far]) > GOOD * _size(data.displacements[tested]) else ()
    bars = surrogate.error_bar(data.domain.points_mm[unseen[tested]], kpa)
    return Result(error, tuple(causes), () if bars is None else (bar_of(np.abs(errors), bars),), guessed)


def _far(points: NDArray[np.float64], trained_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which `points` (N, 2) are so far from all that were trained on that a model may be warned of there."""
    nearest = np.min(np.linalg.norm(points[:, None] - trained_mm[None], axis=2), axis=1)
    return np.asarray(nearest > HOLE * np.ptp(points, axis=0).max())


def _size(vectors: NDArray[np.float64]) -> float:
    return float(np.sqrt((vectors**2).mean()))


def bar_of(errors: NDArray[np.float64], bars: NDArray[np.float64]) -> Bar:
    """Whether |errors| (N, 2) [mm] of points that nobody fitted lie within their `bars` (N,) [mm] as promised."""
    ratios = errors / np.maximum(bars, SMALLEST_MM)[:, None]
    coverage = float((ratios <= 1).mean())
    return Bar("95 %", coverage >= COVERED, coverage, float(np.quantile(ratios, 0.95)), float(ratios.max()))


def _errors(
    surrogate: Surrogate, data: Dataset, place: int, which: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Errors (M, 2) [mm] of the nodes `which` (N,) at one pressure; their root mean square, relative to the truth's."""
    truth = data.displacements[place][which]
    errors = surrogate.predict(data.domain.points_mm[which], float(data.pressures_kpa[place])) - truth
    return errors, _size(errors) / _size(truth)


def _misfit(surrogate: Surrogate, samples: Samples) -> float:
    """Root mean square error at what it learnt from, relative to that of the displacements there."""
    squares = 0.0
    for kpa in np.unique(samples.pressures_kpa):
        here = samples.at(samples.pressures_kpa == kpa)
        squares += float(((surrogate.predict(here.points_mm, float(kpa)) - here.displacements_mm) ** 2).sum())
    return float(np.sqrt(squares / (samples.displacements_mm**2).sum()))


def _points(stress: Stress, data: Dataset, seed: int) -> NDArray[np.int64]:
    """Indices (n,) of the training points."""
    x = data.domain.points_mm[:, 0] / data.domain.points_mm[:, 0].max()
    shown = (x < stress.hidden[0]) | (x >= stress.hidden[1])
    seen = data.pressures_kpa <= stress.trained * data.pressures_kpa[-1] * (1 + 1e-9)
    among = np.flatnonzero(seen[:, None] & shown)
    count = max(2, round(stress.share * len(among)))
    return np.sort(np.random.default_rng(seed).choice(among, count, replace=False))


def _budget(how: Experiment, count: int, updates: int) -> Any:
    """Epochs for some `updates` of a network that `count` samples are given to; time would depend on the machine."""
    fitted = count - int(how.trainer.validation * count)
    per_epoch = -(-fitted // min(how.optimizer.batch_size, fitted))
    epochs = max(1, round(updates / per_epoch))
    return replace(how.trainer, progress=False, accelerator="cpu", max_time=LONGEST, max_epochs=epochs)
