"""Models whose surrogate is a field with trainable weights."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgdl_lab.errors import InputError
from pgdl_lab.model import Model

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.field import Field
    from pgdl_lab.surrogate import Record, Surrogate

ACTIVATIONS = ("relu", "tanh", "silu", "gelu", "softplus", "sin")
DTYPES = ("float32", "float64")


@dataclass(frozen=True)
class NeuralModel(Model):
    """A fully connected network and what surrounds it.

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
    """

    depth: int = 4
    width: int = 128
    activation: str = "silu"
    dtype: str = "float32"

    def __post_init__(self) -> None:
        for name in ("depth", "width"):
            if getattr(self, name) < 1:
                raise InputError(f"model.{name} is {getattr(self, name)}; it must be at least 1.")
        for name, known in (("activation", ACTIVATIONS), ("dtype", DTYPES)):
            if getattr(self, name) not in known:
                raise InputError(f"model.{name} is '{getattr(self, name)}'; choose one of {', '.join(known)}.")

    @abstractmethod
    def new_field(self, training: Training) -> Field:
        """A field with initial weights."""

    @abstractmethod
    def stored_field(self, state: Mapping[str, Tensor]) -> Field:
        """A field of the shape that `state` has; its weights are overwritten afterwards."""

    def fit(self, training: Training) -> Surrogate:
        from pgdl_lab.learning.fit import fit  # torch and Lightning are imported only when they are needed

        return fit(self, training)

    def restore(self, state: Mapping[str, Tensor], record: Record) -> Surrogate:
        from pgdl_lab.learning.neural_surrogate import NeuralSurrogate

        field = self.stored_field(state)
        field.load_state_dict(state)
        return NeuralSurrogate(self, record, field)
