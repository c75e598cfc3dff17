"""The surrogate of a neural model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.deploy.probe import Probe
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.field import Field, ReadOutField
from pgdl_lab.learning.last_layer import BEYOND, LastLayer
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
    last_layer
        Its error bars; None: it has none.
    """

    def __init__(
        self, model: Mapping[str, Any], record: Record, field: ReadOutField, last_layer: LastLayer | None
    ) -> None:
        super().__init__(model, record)
        self.field = field.cpu().eval().requires_grad_(False)
        self.last_layer = last_layer

    def state(self) -> dict[str, NDArray[Any]]:
        weights = {name: tensor.numpy() for name, tensor in self.field.state_dict().items()}
        return weights | (self.last_layer.state() if self.last_layer else {})

    def probe(self, points_mm: Floats) -> FieldProbe:
        return FieldProbe(self.field, points_mm)

    def bars(self, points_mm: Floats, pressures_kpa: Floats) -> Floats | None:
        if self.last_layer is None:
            return None
        bars_mm = np.empty((len(pressures_kpa), len(points_mm)))
        if bars_mm.size:
            coordinates = self.field.coordinates(points_mm, order=0)
            for row, kpa in zip(bars_mm, pressures_kpa, strict=True):
                place, pressure = _features(self.field, coordinates, np.full(len(points_mm), kpa))
                row[:] = self.last_layer.bars(place, pressure[0], float(kpa))
        return bars_mm


def last_layer(field: ReadOutField, samples: Samples, held: NDArray[np.bool_]) -> LastLayer | None:
    """Error bars of a field that was trained on `samples`, but for those that were `held` (n,) back.

    None if the field has no finite numbers for them.
    """
    coordinates = field.cpu().coordinates(samples.points_mm, order=0)
    features = _features(field, coordinates, samples.pressures_kpa)
    pressures_kpa = torch.from_numpy(samples.pressures_kpa).to(coordinates.dtype)
    with torch.no_grad():
        whole, beside = (part(coordinates, pressures_kpa).double().numpy() for part in (field, field.beside))
    errors_mm = whole - samples.displacements_mm
    if not all(np.isfinite(array).all() for array in (*features, errors_mm)):
        return None
    anywhere, above_kpa = coordinates[:, :1].expand(-1, len(BEYOND), -1), (1 + BEYOND) * samples.pressures_kpa.max()
    _, above = _features(field, anywhere, above_kpa)
    targets_mm = samples.displacements_mm - beside
    return LastLayer.fitted(features, samples.pressures_kpa, targets_mm, errors_mm, held, above)


@torch.no_grad()
def _features(field: ReadOutField, coordinates: Tensor, pressures_kpa: Floats) -> tuple[Floats, Floats]:
    place, pressure = field.features(coordinates, torch.from_numpy(pressures_kpa).to(coordinates.dtype))
    return place.double().numpy(), pressure.double().numpy()


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
