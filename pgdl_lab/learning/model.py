"""The plugin kind `model`: a rule that learns a surrogate from training points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.loss import Loss
    from pgdl_lab.surrogate.record import Record
    from pgdl_lab.surrogate.surrogate import Surrogate


@dataclass(frozen=True)
class Model(ABC):
    """A rule that learns a surrogate; its fields are its hyperparameters.

    A subclass sets `in_space` if it can learn a whole body, and not only its side face, and `several_inputs` if it
    takes more inputs than the pressure.
    """

    in_space: ClassVar[bool] = False
    several_inputs: ClassVar[bool] = False

    def left_out(self, losses: Mapping[str, Loss]) -> dict[str, str]:
        """Terms of the loss that this model cannot use, and why; networks use all.

        Raises
        ------
        InputError
            When the model cannot do what these terms ask for.
        """
        return {}

    @abstractmethod
    def fit(self, training: Training) -> Surrogate:
        """Learn from the training points, resuming from `<training.folder>/checkpoints` where a checkpoint lies there.

        Raises
        ------
        InputError
            When the training points or settings do not fit this model, or a checkpoint belongs to another training.
        TrainingDiverged
            When a loss is no longer finite; carries the last good surrogate.
        """

    @abstractmethod
    def restore(self, state: Mapping[str, NDArray[np.generic]], record: Record) -> Surrogate:
        """The surrogate whose `state()` and `record` these are."""
