"""What a model is trained on: sampled points, the body they belong to, and the settings of the training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.simplices import AXES
from pgdl_lab.learning.balancing import BalancingSettings
from pgdl_lab.learning.loss import Loss
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings

SET_ASIDE = 1  # beside the seed: a random stream that nothing else draws from


@dataclass(frozen=True)
class Samples:
    """Training data.

    Attributes
    ----------
    points_mm
        (n, d) float64, x and z of the undeformed points of a face, or x, y and z of a body [mm].
    cases
        The n cases that they were seen in.
    displacements_mm
        (n, d) float64, the components of the displacement [mm].
    """

    points_mm: NDArray[np.float64]
    cases: Cases
    displacements_mm: NDArray[np.float64]

    @classmethod
    def of(cls, data: Dataset, indices: NDArray[np.int64]) -> Samples:
        """The points `indices` (n,) of `data`: point i is node i % N of case i // N."""
        case, node = np.divmod(indices, len(data.domain.points_mm))
        return cls(data.domain.points_mm[node], data.cases.at(case), data.displacements[case, node])

    def __len__(self) -> int:
        return len(self.points_mm)

    @property
    def pressures_kpa(self) -> NDArray[np.float64]:
        """The pressure (n,) of each [kPa]."""
        return self.cases.pressures_kpa

    def at(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Samples:
        """Some of these, by their indices (m,) or a mask (n,)."""
        return Samples(self.points_mm[which], self.cases.at(which), self.displacements_mm[which])

    def joined(self, others: Samples) -> Samples:
        """These and after them the `others`."""
        return Samples(
            np.concatenate([self.points_mm, others.points_mm]),
            self.cases.joined(others.cases),
            np.concatenate([self.displacements_mm, others.displacements_mm]),
        )

    def ranges(self) -> dict[str, list[float]]:
        """Least and greatest value: "x_mm", of a body "y_mm", "z_mm" and each input, such as "pressure_kpa"."""
        places = {f"{axis}_mm": self.points_mm[:, i] for i, axis in enumerate(AXES[self.points_mm.shape[1]])}
        known = {name: [float(values.min()), float(values.max())] for name, values in places.items()}
        return known | self.cases.ranges()


@dataclass(frozen=True)
class Training:
    """One training, complete: what `Model.fit` needs. `Training.of` makes one, and sets points aside.

    Attributes
    ----------
    samples
        The training points that a model is fitted to.
    held
        Those that are set aside, to choose the best state by and to calibrate error bars on; no model learns from them.
    scene
        The body they belong to.
    losses
        The terms of the loss by name.
    trainer, optimizer
        Budget and rule.
    seed
        Fixes initial weights, order of the batches and points drawn by losses.
    folder
        Run folder; checkpoints are written to and resumed from `<folder>/checkpoints`.
    provenance
        Where the data come from (JSON types), kept in the surrogate's file.
    logger
        A Lightning logger, or None.
    balancing
        How the weights of the losses follow the training.
    callbacks
        Lightning callbacks that watch the training.
    """

    samples: Samples
    held: Samples
    scene: Scene
    losses: Mapping[str, Loss]
    trainer: TrainerSettings
    optimizer: OptimizerSettings
    seed: int
    folder: Path
    provenance: Mapping[str, Any]
    logger: Any = None
    balancing: BalancingSettings = field(default_factory=BalancingSettings)
    callbacks: Sequence[Any] = ()

    @classmethod
    def of(
        cls,
        samples: Samples,
        scene: Scene,
        losses: Mapping[str, Loss],
        trainer: TrainerSettings,
        optimizer: OptimizerSettings,
        seed: int,
        folder: Path,
        provenance: Mapping[str, Any],
        **beside: Any,
    ) -> Training:
        """A training of which the share `trainer.validation` of all `samples` is set aside, drawn by the seed.

        Points are set aside here alone, before anything was fitted to them: what is chosen or calibrated on points that
        a model has learnt from tells nothing. `beside` are the fields from `logger` on.
        """
        count = len(samples)
        order = np.random.default_rng([seed, SET_ASIDE]).permutation(count)
        held, fitted = np.split(order, [int(trainer.validation * count)])
        parts = samples.at(np.sort(fitted)), samples.at(np.sort(held))
        return cls(*parts, scene, losses, trainer, optimizer, seed, folder, provenance, **beside)

    @property
    def whole(self) -> Samples:
        """All training points, for models that leave each out in turn to see how they err, and then learn from all."""
        return self.samples.joined(self.held)
