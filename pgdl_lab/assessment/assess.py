"""One assessment for every surrogate: metrics.json and figures."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.assessment.figures import draw
from pgdl_lab.assessment.latency import latency_ms
from pgdl_lab.assessment.residuals import residuals
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.files import replacing
from pgdl_lab.core.split import Split
from pgdl_lab.learning.data import Training
from pgdl_lab.surrogate.surrogate import Surrogate

_log = logging.getLogger(__name__)
_tracebacks = logging.getLogger("pgdl_lab.failure")  # goes to run.log only


@dataclass(frozen=True)
class Labels:
    """Names of what was run.

    Attributes
    ----------
    finger, fem, split, model
        Plugin names.
    losses
        Names of the loss terms.
    left_out
        Those that the model could not use, and why.
    seed
        The seed.
    """

    finger: str
    fem: str
    split: str
    model: str
    losses: list[str]
    left_out: dict[str, str]
    seed: int


@dataclass(frozen=True)
class Assessment:
    """What an assessment found.

    Attributes
    ----------
    metrics
        The content of metrics.json, numbers unrounded.
    figures
        The PNG files.
    highlights
        Indices of the snapshots that tables show.
    """

    metrics: dict[str, Any]
    figures: list[Path]
    highlights: NDArray[np.int64]


def assess(
    surrogate: Surrogate,
    snapshots: Dataset,
    train: NDArray[np.int64],
    selection: NDArray[np.int64],
    split: Split,
    labels: Labels,
    seconds: Mapping[str, float],
    folder: Path,
    training: Training,
    yardstick: Mapping[str, Any] | None = None,
) -> Assessment:
    """Judge `surrogate` on all of `snapshots` and write `<folder>/metrics.json`, then `<folder>/figures/*.png`.

    Parameters
    ----------
    surrogate
        A trained model.
    snapshots
        The simulation.
    train, selection
        (n,) and (m,), indices of the training points and of those that a search selects by.
    split
        Tells which snapshots tables and base-line figures show.
    labels
        Names of what was run.
    seconds
        Times so far: "simulate", "simulate_cached", "train" [s]; "assess" is added.
    folder
        Run folder.
    training
        How it was trained, for the residuals of its losses.
    yardstick
        What `yardstick.measure` found, if there is one.
    """
    start = time.perf_counter()
    predicted = surrogate.predict(snapshots.domain.points_mm, snapshots.pressures_kpa, beyond=True)
    bars = surrogate.error_bar(snapshots.domain.points_mm, snapshots.pressures_kpa, beyond=True)
    comparison = Comparison(snapshots, predicted, train, bars, selection)
    highlights = split.highlights(snapshots.cases)
    units = {name: loss.unit for name, loss in training.losses.items()}
    terms = residuals(training.losses, training.scene, snapshots, predicted, highlights)
    metrics = {
        **asdict(labels),
        "points": predicted.shape[0] * predicted.shape[1],
        "train_points": len(train),
        "selection_points": len(selection),
        "test_points": int(comparison.unseen.sum()),
        "seconds": {},
        "warnings": surrogate.warnings,
        "surrogate_error": comparison.error(),
        "discretisation_error": snapshots.provenance.get("discretisation_error"),
        "mse_mm2": comparison.mse_mm2(),
        "selection_mm2": comparison.selection_mm2(),
        "error_bar": comparison.error_bar(),
        "by_pressure": comparison.by_pressure(),
        "extremes_mm": comparison.extremes_mm(),
        "curvature": comparison.curvature(),
        "latency_ms": latency_ms(
            surrogate, snapshots.domain.points_mm, int(snapshots.domain.base[-1]), float(snapshots.pressures_kpa[-1])
        ),
        "residuals": {name: {**values, "unit": units[name]} for name, values in terms.items()},
        "yardstick": yardstick,
    }
    metrics["seconds"] = {**seconds, "assess": time.perf_counter() - start}
    with replacing(folder / "metrics.json") as temporary:
        temporary.write_text(json.dumps(metrics, indent=1))
    figures: list[Path] = []
    try:
        figures = draw(comparison, highlights, surrogate.record.history, units, folder / "figures")
    except Exception as error:  # a full disk or a font: no figure is worth the run
        _log.warning("The figures could not be drawn: %s", error)
        _tracebacks.info("The figures could not be drawn", exc_info=True)
    return Assessment(metrics, figures, highlights)
