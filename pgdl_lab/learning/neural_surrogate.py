"""The surrogate of a neural model."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.learning.field import Field
from pgdl_lab.model import Model
from pgdl_lab.surrogate import Record, Surrogate


class NeuralSurrogate(Surrogate):
    """A trained field; the coordinates of the points asked for last are kept, as control loops ask for the same ones.

    Parameters
    ----------
    model, record
        See `Surrogate`.
    field
        The trained field.
    """

    def __init__(self, model: Model, record: Record, field: Field) -> None:
        super().__init__(model, record)
        self.field = field.cpu().eval().requires_grad_(False)
        self._points = np.empty((0, 2))
        self._coordinates = torch.empty(0)

    def state(self) -> dict[str, Tensor]:
        return dict(self.field.state_dict())

    @torch.no_grad()
    def displacements(self, points_mm: NDArray[np.float64], pressures_kpa: NDArray[np.float64]) -> NDArray[np.float64]:
        if not np.array_equal(points_mm, self._points):
            self._coordinates = self.field.coordinates(points_mm, order=0)
            self._points = points_mm.copy()
        pressures = torch.from_numpy(pressures_kpa).to(self._coordinates.dtype)
        return self.field.displacements(self._coordinates, pressures).double().numpy()
