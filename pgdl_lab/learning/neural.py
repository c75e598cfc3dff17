"""Models in which a network is trained."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import describe
from pgdl_lab.learning.model import Model

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from pgdl_lab.learning.data import Samples, Training
    from pgdl_lab.learning.field import Field, ReadOutField
    from pgdl_lab.surrogate.record import Record
    from pgdl_lab.surrogate.surrogate import Surrogate

ACTIVATIONS = ("relu", "tanh", "silu", "gelu", "softplus", "sin")
DTYPES = ("float32", "float64")


@dataclass(frozen=True)
class TrainedModel(Model):
    """A model in which a fully connected network is trained.

    Attributes
    ----------
    depth
        Number of hidden layers.
    width
        Neurons in each of them.
    activation
        "relu", "tanh", "silu", "gelu", "softplus" or "sin".
    dtype
        "float32" or "float64".
    patience
        Epochs without a better state on the points set aside, or without one that surely gains on the start, after
        which training ends; null: at its budget's end.
    """

    optimizer: ClassVar[str] = "adam"  # where optimizer.name is null

    depth: int = 4
    width: int = 128
    activation: str = "silu"
    dtype: str = "float32"
    patience: int | None = None

    def __post_init__(self) -> None:
        for name in ("depth", "width"):
            if getattr(self, name) < 1:
                raise InputError(f"model.{name} is {getattr(self, name)}; it must be at least 1.")
        for name, known in (("activation", ACTIVATIONS), ("dtype", DTYPES)):
            if getattr(self, name) not in known:
                raise InputError(f"model.{name} is '{getattr(self, name)}'; choose one of {', '.join(known)}.")

        if self.patience is not None and self.patience < 1:
            raise InputError(f"model.patience is {self.patience}; it must be at least 1, or null.")

    @abstractmethod
    def begin(self, training: Training) -> tuple[Field, Samples]:
        """A field with initial weights and the points that it is trained on, from `training.samples` alone."""

    @abstractmethod
    def finished(self, field: Any, record: Record, training: Training) -> Surrogate:
        """The surrogate of a field that was trained on `training.samples` and has not seen those held back."""

    def fit(self, training: Training) -> Surrogate:
        from pgdl_lab.learning.fit import fit  # torch and Lightning are imported only when they are needed

        return fit(self, training)


@dataclass(frozen=True)
class NeuralModel(TrainedModel):
    """A model whose surrogate is the trained field itself."""

    def begin(self, training: Training) -> tuple[Field, Samples]:
        return self.new_field(training), training.samples

    def finished(self, field: ReadOutField, record: Record, training: Training) -> Surrogate:
        from pgdl_lab.learning.left_out import bars_left_out
        from pgdl_lab.learning.neural_surrogate import NeuralSurrogate

        spent_s = record.history[-1]["seconds"] if record.history else 0.0
        bars = bars_left_out(self, training, field.cpu(), spent_s)
        return NeuralSurrogate(describe(self), record, field, bars)

    @abstractmethod
    def new_field(self, training: Training) -> ReadOutField:
        """A field with initial weights."""

    @abstractmethod
    def stored_field(self, state: Mapping[str, Tensor]) -> ReadOutField:
        """A field of the shape that `state` has; its weights are overwritten afterwards."""

    def restore(self, state: Mapping[str, NDArray[np.generic]], record: Record) -> Surrogate:
        import torch

        from pgdl_lab.learning.neural_surrogate import NeuralSurrogate
        from pgdl_lab.surrogate.last_layer import STATE, LastLayer

        tensors = {name: torch.from_numpy(array) for name, array in state.items() if not name.startswith(STATE)}
        if self.depth > len(tensors):
            raise ValueError(f"model.depth is {self.depth}, and there are {len(tensors)} arrays")
        with torch.device("meta"):  # however large a network the settings ask for, it takes no memory
            field = self.stored_field(tensors)
        field.load_state_dict(tensors, assign=True)
        return NeuralSurrogate(describe(self), record, field, LastLayer.restored(state, record.domain))
