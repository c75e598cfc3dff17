"""The scenes that benchmarks measure: fingers of the lab, small ones for a quick run, simulated and learnt."""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core import paths
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.running import cache
from pgdl_lab.running.composing import experiment
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.surrogate.surrogate import Surrogate

FINGERS = ("pneunet", "joints", "bellows")
"""The fingers of the paper."""

SMALL = {
    "pneunet": ["finger.chambers=3"],
    "pneunet_reference": ["finger.chambers=3"],
    "joints": ["finger.joints=1", "finger.chambers=2"],
    "bellows": ["finger.folds=3"],
}
COARSE = [
    *("fem.edge_mm=6", "fem.estimate_error=false", "observation.snapshots=20", "observation.points=400"),
    *("split.points=600", "trainer.max_time=20", "trainer.max_epochs=20"),
]


def scene(finger: str, *choices: str, quick: bool = False) -> Experiment:
    """What `python -m pgdl_lab finger=FINGER CHOICES` runs, without a progress bar; small for a quick run."""
    small = SMALL[finger] + COARSE if quick else []
    return experiment([f"finger={finger}", *small, *choices, "trainer.progress=false"])


def simulated(made: Experiment) -> Dataset:
    """The snapshots of an experiment, from runs/snapshots if they are there."""
    return cache.simulate(made.finger, made.fem, made.observation, paths.RUNS / "snapshots")[0]


def fitted(made: Experiment, data: Dataset, train: NDArray[np.int64], **beside: Any) -> tuple[Surrogate, float]:
    """A surrogate that learnt from the points `train` of `data`, and the time of its training [s]."""
    with tempfile.TemporaryDirectory() as folder:
        training = made.training(data, train, Path(folder), **beside)
        began = time.perf_counter()
        return made.model.fit(training), time.perf_counter() - began


def unseen_of(data: Dataset, train: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which points (P, N) are not among those trained on."""
    unseen = np.ones(data.displacements.shape[:2], dtype=bool)
    unseen.flat[train] = False
    return unseen
