"""The surrogate of a neural model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pgdl_lab.deploy.probe import Probe
from pgdl_lab.learning.field import Field
from pgdl_lab.surrogate import Record, Surrogate

Floats = NDArray[np.float64]


class NeuralSurrogate(Surrogate):
    """A trained field.

    Parameters
    ----------
    model, record
        See `Surrogate`.
    field
        The trained field.
    """

    def __init__(self, model: Mapping[str, Any], record: Record, field: Field) -> None:
        super().__init__(model, record)
        self.field = field.cpu().eval().requires_grad_(False)

    def state(self) -> dict[str, NDArray[Any]]:
        return {name: tensor.numpy() for name, tensor in self.field.state_dict().items()}

    def probe(self, points_mm: Floats) -> FieldProbe:
        return FieldProbe(self.field, points_mm)


class FieldProbe(Probe):
    """A trained field at fixed points, whose coordinates are kept.

    Parameters
    ----------
    field
        The field.
    points_mm
        (N, 2) [mm].
    """

    def __init__(self, field: Field, points_mm: Floats) -> None:
        self._field = field
        self._coordinates = field.coordinates(points_mm, order=0)

    def value(self, kpa: float) -> Floats:
        return self.values(np.array([kpa]))[0]

    @torch.no_grad()
    def values(self, pressures_kpa: Floats) -> Floats:
        pressures = torch.from_numpy(pressures_kpa).to(self._coordinates.dtype)
        return self._field.displacements(self._coordinates, pressures).double().numpy()

    def slope(self, kpa: float) -> Floats:
        # each point has a pressure of its own, so that the gradient of a sum over all points is that of each
        pressures = self._coordinates.new_full((self._coordinates.shape[1],), kpa, requires_grad=True)
        field = self._field(self._coordinates, pressures)
        along = [torch.autograd.grad(field[:, i].sum(), pressures, retain_graph=i == 0)[0] for i in range(2)]
        return torch.stack(along, dim=1).double().numpy()
