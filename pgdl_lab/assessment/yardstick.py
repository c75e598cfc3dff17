"""A model that is fitted in a second beside the chosen one, so that every run shows what its training was worth."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.registry import describe, plugin
from pgdl_lab.learning.data import Training
from pgdl_lab.learning.linear import DATA
from pgdl_lab.learning.model import Model


def measure(
    model: Model, training: Training, snapshots: Dataset, train: NDArray[np.int64], selection: NDArray[np.int64]
) -> dict[str, Any]:
    """Errors of `model` on the same training points.

    Parameters
    ----------
    model
        The yardstick.
    training
        The training of the chosen model; whatever its losses are, only the data count here.
    snapshots
        The simulation.
    train, selection
        (n,) and (m,), indices of the training points and of those that a search selects by.

    Returns
    -------
    "model", "seconds", and "mse_mm2" and "by_pressure" as in metrics.json.
    """
    start = time.perf_counter()
    alone = replace(
        training, losses={DATA: plugin("loss", DATA)()}, folder=training.folder / "yardstick", logger=None, callbacks=()
    )
    surrogate = model.fit(alone)
    seconds = time.perf_counter() - start
    predicted = surrogate.predict(snapshots.domain.points_mm, snapshots.pressures_kpa, beyond=True)
    comparison = Comparison(snapshots, predicted, train, selection=selection)
    return {
        "model": describe(model)["name"],
        "seconds": seconds,
        "mse_mm2": comparison.mse_mm2(),
        "by_pressure": comparison.by_pressure(),
    }
