"""A short finger whose whole body is known, and a surrogate of it."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.doubt import trained
from pgdl_lab.learning.scene import Scene
from pgdl_lab.mechanics.whole_body import observed
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.fingers import pneunet, solid
from tests.trainings import training

PRESSURES = Observation(snapshots=10, points=300)


@cache
def whole_finger() -> Any:
    return pneunet(chambers=1, max_kpa=10.0)


@cache
def simulated() -> Dataset:
    """The side face, with the body beside it."""
    return solid(element="hex27_p1").simulate(whole_finger(), PRESSURES)


def body() -> Dataset:
    """The body at its equilibria."""
    found = simulated().body
    assert found is not None
    return found


@cache
def observed_body() -> Dataset:
    """The body at the observed pressures."""
    return observed(simulated(), Observation(snapshots=10, points=300, of="body"))


def train_points(count: int = 3000) -> np.ndarray:
    data = observed_body()
    return np.sort(np.random.default_rng(0).choice(data.displacements[..., 0].size, count, replace=False))


def learnt(folder: Path, model: str = "pod", losses: tuple[str, ...] = ("data",), **fields: Any) -> Surrogate:
    """A surrogate of the body that learns from `train_points`."""
    data = observed_body()
    how = training(
        folder, dict.fromkeys(losses, {}), samples=Samples.of(data, train_points()),
        scene=Scene.of(whole_finger(), data), provenance=data.provenance,
        max_epochs=fields.pop("max_epochs", 3), lr=fields.pop("lr", 1e-3),
    )  # fmt: skip
    return trained(plugin("model", model)(**fields), how)
