"""Model `mlp`: a plain fully connected network of place and inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.learning.neural import NeuralModel

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.field import PlaneField


@register("model", "mlp")
@dataclass(frozen=True)
class Mlp(NeuralModel):
    """A fully connected network of (x, z, p), as in the paper (section II-E), p all inputs; of a body of (x, y, z, p).

    Attributes
    ----------
    interval
        Interval that inputs and outputs are scaled to by their training ranges; the paper's is [0, 1].
    """

    in_space: ClassVar[bool] = True
    several_inputs: ClassVar[bool] = True

    interval: list[float] = field(default_factory=lambda: [-1.0, 1.0])

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.interval) != 2 or not self.interval[0] < self.interval[1]:
            raise InputError(f"model.interval is {list(self.interval)}; give two rising numbers, such as [-1, 1].")

    def new_field(self, training: Training) -> PlaneField:
        samples = training.samples
        inputs = np.column_stack([samples.points_mm, samples.cases.values])
        return self._field(inputs.min(axis=0), inputs.max(axis=0), *(
            bound(samples.displacements_mm, axis=0) for bound in (np.min, np.max)
        ))  # fmt: skip

    def stored_field(self, state: Mapping[str, Tensor]) -> PlaneField:
        scales = [len(array) for name, array in state.items() if name.endswith(".scale")]
        inputs, outputs = max(scales), min(scales)  # place and case, and the components of the displacement
        return self._field(np.zeros(inputs), np.ones(inputs), np.zeros(outputs), np.ones(outputs))

    def _field(self, low_in: np.ndarray, high_in: np.ndarray, low_out: np.ndarray, high_out: np.ndarray) -> PlaneField:
        """The network between two scalings, for the given ranges of inputs (d + D,) and outputs (d,)."""
        import torch

        from pgdl_lab.learning.field import PlaneField
        from pgdl_lab.learning.jet import Affine
        from pgdl_lab.learning.layers import DTYPES, fully_connected

        low, high = self.interval
        # a range of width zero, such as that of a single pressure, is scaled as if it were 1 wide
        span_in, span_out = (np.where(span > 0, span, 1.0) for span in (high_in - low_in, high_out - low_out))
        scale_in, scale_out = (high - low) / span_in, span_out / (high - low)
        layers = torch.nn.Sequential(
            Affine(torch.from_numpy(scale_in), torch.from_numpy(low - low_in * scale_in)),
            *fully_connected(len(low_in), len(low_out), self.depth, self.width, self.activation),
            Affine(torch.from_numpy(scale_out), torch.from_numpy(low_out - low * scale_out)),
        )
        return PlaneField(layers, DTYPES[self.dtype])
