"""The surrogate of a neural model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.field import Field, ReadOutField
from pgdl_lab.surrogate.calibration import FEWEST
from pgdl_lab.surrogate.last_layer import BEYOND, LastLayer, ridge, scores
from pgdl_lab.surrogate.probe import Probe
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.surrogate import Surrogate

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
        self.knows_body = field.knows_body
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
        return bars_mm * self.last_layer.stretched(self.record.domain, points_mm)


def last_layer(
    field: ReadOutField, trained: Samples, held: Samples, scores_mm: Floats | None = None
) -> LastLayer | None:
    """Error bars of a field that was `trained` on some samples and has not seen those `held` back.

    None if the field has no finite numbers for them, or too few samples tell how it errs.
    """
    samples = trained.joined(held)
    told = len(held.pressures_kpa) if scores_mm is None and len(held.pressures_kpa) else len(samples.pressures_kpa)
    if told < FEWEST:
        return None
    aside = np.arange(len(samples.pressures_kpa)) >= len(trained.pressures_kpa)
    coordinates = field.cpu().coordinates(samples.points_mm, order=0)
    features = _features(field, coordinates, samples.pressures_kpa)
    errors_mm = _values(field, coordinates, samples.pressures_kpa) - samples.displacements_mm
    if not all(np.isfinite(array).all() for array in (*features, errors_mm)):
        return None
    anywhere, above_kpa = coordinates[:, :1].expand(-1, len(BEYOND), -1), (1 + BEYOND) * samples.pressures_kpa.max()
    _, above = _features(field, anywhere, above_kpa)
    targets_mm = samples.displacements_mm - _values(field.beside, coordinates, samples.pressures_kpa)
    return LastLayer.fitted(features, samples.pressures_kpa, targets_mm, errors_mm, aside, above, scores_mm)


def ridge_of(field: ReadOutField, samples: Samples) -> float:
    """See `last_layer.ridge`, of a field that was trained on `samples`."""
    coordinates = field.coordinates(samples.points_mm, order=0)
    targets_mm = samples.displacements_mm - _values(field.beside, coordinates, samples.pressures_kpa)
    return ridge(_features(field, coordinates, samples.pressures_kpa), targets_mm)


def scores_mm(field: ReadOutField, trained: Samples, asked: Samples, rho: float) -> Floats:
    """See `last_layer.scores`, of a field that was `trained` on some samples, at others."""
    place, trained_place = (field.cpu().coordinates(samples.points_mm, order=0) for samples in (asked, trained))
    errors_mm = _values(field, place, asked.pressures_kpa) - asked.displacements_mm
    features = _features(field, place, asked.pressures_kpa)
    return scores(errors_mm, features, _features(field, trained_place, trained.pressures_kpa), rho)


@torch.no_grad()
def _values(part: Callable[[Tensor, Tensor], Tensor], coordinates: Tensor, pressures_kpa: Floats) -> Floats:
    """Displacements (n, d) [mm] of a field or of a part of it."""
    return part(coordinates, torch.from_numpy(pressures_kpa).to(coordinates.dtype)).double().numpy()


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
        (N, d) [mm].
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
        along = [
            torch.autograd.grad(field[:, i].sum(), pressures, retain_graph=i == 0)[0] for i in range(field.shape[1])
        ]
        return torch.stack(along, dim=1).double().numpy()
