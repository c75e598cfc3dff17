"""Surrogates of all models, small and quickly trained."""

from pathlib import Path

import torch

from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.trainings import training

discover()
MODELS = {
    "mlp": {"depth": 1, "width": 8, "interval": [0.0, 1.0]},
    "body": {"depth": 1, "width": 8, "modes": 16},
    "finite_element": {"degree": 3},
    "pod": {"degree": 3, "rounds": 1, "draws": 8},
    "gaussian_process": {"points": 200, "modes": 16},
    "hybrid": {"degree": 3, "rounds": 1, "width": 4},
}


def trained(name: str, folder: Path) -> Surrogate:
    torch.set_num_threads(1)
    model = plugin("model", name)(**MODELS[name])
    surrogate = model.fit(training(folder, {"data": {}}, max_epochs=1))
    assert isinstance(surrogate, Surrogate)
    return surrogate
