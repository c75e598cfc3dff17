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
from pgdl_lab.surrogate.probe import Case, Probe
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

    def bars(self, points_mm: Floats, cases: Floats) -> Floats | None:
        if self.last_layer is None:
            return None
        bars_mm = np.empty((len(cases), len(points_mm)))
        if bars_mm.size:
            coordinates = self.field.coordinates(points_mm, order=0)
            for row, case, far in zip(bars_mm, _rows(cases), self.along(cases), strict=True):
                place, inputs = _features(self.field, coordinates, np.tile(case, (len(points_mm), 1)))
                row[:] = self.last_layer.bars(place, inputs[0], float(far))
        return bars_mm * self.last_layer.stretched(self.record.domain, points_mm)


def last_layer(
    field: ReadOutField, trained: Samples, held: Samples, scores_mm: Floats | None = None
) -> LastLayer | None:
    """Error bars of a field that was `trained` on some samples and has not seen those `held` back.

    None if the field has no finite numbers for them, or too few samples tell how it errs.
    """
    samples = trained.joined(held)
    told = len(held) if scores_mm is None and len(held) else len(samples)
    if told < FEWEST:
        return None
    aside = np.arange(len(samples)) >= len(trained)
    coordinates = field.cpu().coordinates(samples.points_mm, order=0)
    cases = samples.cases.values
    features = _features(field, coordinates, cases)
    errors_mm = _values(field, coordinates, cases) - samples.displacements_mm
    if not all(np.isfinite(array).all() for array in (*features, errors_mm)):
        return None
    anywhere, highest = coordinates[:, :1].expand(-1, len(BEYOND), -1), cases[cases[:, 0].argmax()]
    _, above = _features(
        field, anywhere, np.column_stack([(1 + BEYOND) * highest[0], *np.tile(highest[1:, None], len(BEYOND))])
    )
    targets_mm = samples.displacements_mm - _values(field.beside, coordinates, cases)
    return LastLayer.fitted(features, cases[:, 0], targets_mm, errors_mm, aside, above, scores_mm)


def ridge_of(field: ReadOutField, samples: Samples) -> float:
    """See `last_layer.ridge`, of a field that was trained on `samples`."""
    coordinates = field.coordinates(samples.points_mm, order=0)
    targets_mm = samples.displacements_mm - _values(field.beside, coordinates, samples.cases.values)
    return ridge(_features(field, coordinates, samples.cases.values), targets_mm)


def scores_mm(field: ReadOutField, trained: Samples, asked: Samples, rho: float) -> Floats:
    """See `last_layer.scores`, of a field that was `trained` on some samples, at others."""
    place, trained_place = (field.cpu().coordinates(samples.points_mm, order=0) for samples in (asked, trained))
    errors_mm = _values(field, place, asked.cases.values) - asked.displacements_mm
    features = _features(field, place, asked.cases.values)
    return scores(errors_mm, features, _features(field, trained_place, trained.cases.values), rho)


@torch.no_grad()
def _values(part: Callable[[Tensor, Tensor], Tensor], coordinates: Tensor, cases: Floats) -> Floats:
    """Displacements (n, d) [mm] of a field or of a part of it, in cases (n, D)."""
    return part(coordinates, torch.from_numpy(cases).to(coordinates.dtype)).double().numpy()


@torch.no_grad()
def _features(field: ReadOutField, coordinates: Tensor, cases: Floats) -> tuple[Floats, Floats]:
    place, inputs = field.features(coordinates, torch.from_numpy(cases).to(coordinates.dtype))
    return place.double().numpy(), inputs.double().numpy()


def _rows(cases: Floats) -> Floats:
    """Cases (n, D), from (n,) where there is one input."""
    return cases if cases.ndim > 1 else cases[:, None]


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

    def value(self, case: Case) -> Floats:
        return self.values(np.array([case]))[0]

    @torch.no_grad()
    def values(self, cases: Floats) -> Floats:
        rows = torch.from_numpy(_rows(cases)).to(self._coordinates.dtype)
        return self._field.displacements(self._coordinates, rows).double().numpy()

    def slope(self, case: Case) -> Floats:
        # each point has a case of its own, so that the gradient of a sum over all points is that of each
        values = torch.from_numpy(np.atleast_1d(np.asarray(case, dtype=np.float64))).to(self._coordinates.dtype)
        cases = values.repeat(self._coordinates.shape[1], 1).requires_grad_()
        field = self._field(self._coordinates, cases)
        count = field.shape[1]
        along = [torch.autograd.grad(field[:, i].sum(), cases, retain_graph=i < count - 1)[0] for i in range(count)]
        slopes = torch.stack(along, dim=1).double().numpy()
        return slopes if np.ndim(case) else slopes[..., 0]
