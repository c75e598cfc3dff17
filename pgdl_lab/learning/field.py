"""Displacement fields with trainable weights."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pgdl_lab.learning.jet import ROWS, Jet, propagate


class Field(nn.Module, ABC):
    """A displacement [mm] as a function of place [mm] and D inputs, with its derivatives by place.

    A field is evaluated in two steps, because the first has nothing to learn and is taken once for all training points:
    `coordinates` are fixed functions of the place (the place itself, or functions that know the body), and `rows`
    carries them and the inputs through the trainable layers.

    Attributes
    ----------
    knows_body
        Whether a point off the body counts as the nearest one on it.
    """

    knows_body: bool = True

    @abstractmethod
    def coordinates(self, points_mm: NDArray[np.float64], order: int) -> Tensor:
        """Coordinates of points (N, 2) [mm] and their derivatives by x and z [1/mm, 1/mm²] up to `order`: (J, N, F)."""

    @abstractmethod
    def rows(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        """Displacement and derivatives (J, n, 2), see `Jet`, from coordinates (J, n, F) and cases (n, D)."""

    def jet(self, coordinates: Tensor, cases: Tensor, order: int) -> Jet:
        """Displacement and derivatives up to `order`."""
        return Jet(self.rows(coordinates[: ROWS[order]], cases), cases[:, 0])

    def forward(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        """Displacement (n, 2) [mm] from coordinates (J, n, F) and cases (n, D)."""
        return self.rows(coordinates[:1], cases)[0]

    def displacements(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        """Displacements (P, N, d) [mm] of all points with coordinates (1, N, F) in all cases (P, D)."""
        count = coordinates.shape[1]
        fields = [self(coordinates, case.expand(count, -1)) for case in cases]
        return torch.stack(fields) if fields else self(coordinates, cases.new_zeros(count, cases.shape[1]))[None][:0]


class ReadOutField(Field):
    """A field whose last layer is linear: what it weighs is known."""

    @abstractmethod
    def features(self, coordinates: Tensor, cases: Tensor) -> tuple[Tensor, Tensor]:
        """Features (n, H) and (n, K) whose products the last layer sums up; only the first may depend on the place.

        Parameters
        ----------
        coordinates, cases
            (J, n, F) and (n, D), see `rows`.
        """

    def beside(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        """Displacement (n, d) [mm] that does not come from the last layer, from the same; here none: (n, 1)."""
        return coordinates.new_zeros(coordinates.shape[1], 1)


class PlaneField(ReadOutField):
    """A network whose inputs are the place and those of the cases.

    Parameters
    ----------
    layers
        A sequence that ends with a linear layer and an `Affine`. Takes x, in space y, z [mm] and the case, (…, d + D);
        gives (…, d) [mm]. Scaling is part of it, so that every derivative of the field is physical.
    dtype
        Type of the weights.
    """

    knows_body = False

    def __init__(self, layers: nn.Sequential, dtype: torch.dtype) -> None:
        super().__init__()
        self.layers = layers.to(dtype)
        self.dtype = dtype

    def coordinates(self, points_mm: NDArray[np.float64], order: int) -> Tensor:
        rows = torch.zeros(ROWS[order], *points_mm.shape, dtype=self.dtype)
        rows[0] = torch.from_numpy(points_mm)
        if order:
            rows[1, :, 0] = 1  # ∂x/∂x
            rows[2, :, 1] = 1  # ∂z/∂z
        return rows

    def rows(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        beside = coordinates.new_zeros(*coordinates.shape[:-1], cases.shape[1])
        beside[0] = cases
        return propagate(self.layers, torch.cat([coordinates, beside], dim=-1))

    def features(self, coordinates: Tensor, cases: Tensor) -> tuple[Tensor, Tensor]:
        inputs = torch.cat([coordinates[0], cases.to(self.dtype)], dim=1)
        hidden = self.layers[:-2](inputs)  # without the last layer and the scaling of its outputs
        one = torch.ones_like(hidden[:, :1])
        return torch.cat([hidden, one], dim=1), one
