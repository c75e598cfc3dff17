"""Small trainings on made-up snapshots."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
from tests.synthetic import snapshots

discover()
small = cache(lambda: snapshots(cell_mm=2.5, count=20))
QUICK: dict[str, Any] = {"progress": False, "max_epochs": 3, "accelerator": "cpu", "log_every_s": 0}
TRAIN = np.sort(np.random.default_rng(0).choice(20 * len(small().domain.points_mm), 2000, replace=False))


def scene(data: Dataset) -> Scene:
    """The body of `data`, of a rubber with round numbers."""
    return Scene(data.domain, float(data.pressures_kpa[-1]), 10.0, 0.5, (0.0, -1e-5))


def training(folder: Path, losses: dict[str, Any], **changes: Any) -> Training:
    """A training of a few epochs; `changes` are fields of `Training`, of its trainer or of its optimizer."""
    trainer = {key: changes.pop(key) for key in list(changes) if key in TrainerSettings.__dataclass_fields__}
    optimizer = {key: changes.pop(key) for key in list(changes) if key in OptimizerSettings.__dataclass_fields__}
    data = small()
    defaults: dict[str, Any] = {
        "samples": Samples.of(data, TRAIN),
        "scene": scene(data),
        "losses": {name: plugin("loss", name)(**fields) for name, fields in losses.items()},
        "trainer": TrainerSettings(**{**QUICK, **trainer}),
        "optimizer": OptimizerSettings(**optimizer),
        "seed": 0,
        "folder": folder,
        "provenance": {"origin": "synthetic"},
    }
    return Training.of(**{**defaults, **changes})
