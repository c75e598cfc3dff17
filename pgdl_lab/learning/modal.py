"""A displacement field on coordinates that know the body."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.field import ReadOutField
from pgdl_lab.learning.jet import ROWS, propagate
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.triangulation import Triangulation

# The least-squares start punishes mode m in the k-th Chebyshev polynomial by RIDGE · (λ_m / λ_max)² · GROWTH^k per
# sample: fast changes along the body and in pressure are taken up only as far as the data ask for them.
RIDGE = 1e-2
GROWTH = 256.0
FLOOR = 1e-6  # keeps the normal matrix regular where the data say nothing

# Coefficients of a smooth function fall off with the degree. Outputs are scaled alike, so that equal steps of the
# optimiser change high degrees less: they are what runs away when the field is asked for pressures beyond the data.
DECAY = 0.2


class ModalField(ReadOutField):
    """A network of the body's Laplace eigenfunctions gives coefficients of Chebyshev polynomials in the inputs.

    Two chambers that part across a slot lie close in the plane and far apart along the body. The eigenfunctions of the
    body tell them apart, so the network can be smooth where the displacement is not. It has a linear part, which starts
    from a linear least-squares fit of the training data, and a deep part, which starts from zero.

    Parameters
    ----------
    points_mm, triangles
        (N, 2) float64 [mm] and (T, 3) int64, the undeformed body.
    modes, eigenvalues
        (N, M) and (M,) [1/mm²], see `Triangulation.modes`.
    basis
        The K polynomials.
    deep
        The deep part, from (…, M) to (…, 2 K).
    dtype
        Type of the weights.
    """

    points_mm: Tensor
    triangles: Tensor
    modes: Tensor
    eigenvalues: Tensor
    decay: Tensor

    def __init__(
        self,
        points_mm: Tensor,
        triangles: Tensor,
        modes: Tensor,
        eigenvalues: Tensor,
        basis: Basis,
        deep: nn.Sequential,
        dtype: torch.dtype,
    ) -> None:
        super().__init__()
        self.register_buffer("points_mm", points_mm)
        self.register_buffer("triangles", triangles)
        self.register_buffer("modes", modes)
        self.register_buffer("eigenvalues", eigenvalues)
        for name, array in basis.state().items():
            self.register_buffer(name, torch.from_numpy(array))
        self._parts = tuple(basis.state())
        self._orders = torch.tensor([sum(each) for each in basis.degrees])
        self.register_buffer("decay", DECAY**self._orders)
        self.deep = deep
        self.linear = nn.Linear(modes.shape[1], 2 * len(basis.degrees))
        self.dtype = dtype
        self.to(dtype)
        self.points_mm = points_mm  # stays in float64: points are located in it

    @cached_property
    def body(self) -> Triangulation:
        """The undeformed body."""
        return Triangulation(self.points_mm.cpu().numpy(), self.triangles.cpu().numpy())

    def coordinates(self, points_mm: NDArray[np.float64], order: int) -> Tensor:
        corners, weights = self.body.locate(points_mm)
        modes = self.modes.cpu().double().numpy()
        tables = [modes, *(matrix @ modes for matrix in self.body.derivatives[: ROWS[order] - 1])] if order else [modes]
        rows = [np.einsum("nc,ncm->nm", weights, table[corners]) for table in tables]
        return torch.from_numpy(np.stack(rows)).to(self.dtype)

    def rows(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        return torch.einsum("jnkc,nk->jnc", self.coefficients(coordinates), self.polynomials(cases))

    def coefficients(self, coordinates: Tensor) -> Tensor:
        """Coefficients (J, n, K, 2) [mm] and derivatives from coordinates (J, n, M)."""
        both = propagate(self.deep, coordinates) + propagate(self.linear, coordinates)
        return self.decay[:, None] * torch.unflatten(both, -1, (-1, 2))

    def polynomials(self, cases: Tensor) -> Tensor:
        """Chebyshev polynomials (n, K) in cases (n, D); they go on beyond the ranges."""
        return torch.stack(self._basis.terms(cases.unbind(dim=1)), dim=-1)

    @cached_property
    def _basis(self) -> Basis:
        return Basis.restored({name: getattr(self, name).cpu().numpy() for name in self._parts}, len(self._orders))

    def features(self, coordinates: Tensor, cases: Tensor) -> tuple[Tensor, Tensor]:
        hidden = self.deep[:-1](coordinates[0])
        return torch.cat([hidden, torch.ones_like(hidden[:, :1])], dim=1), self.decay * self.polynomials(cases)

    def beside(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        coefficients = self.decay[:, None] * torch.unflatten(self.linear(coordinates[0]), -1, (-1, 2))
        return torch.einsum("nkc,nk->nc", coefficients, self.polynomials(cases))

    def displacements(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        return torch.einsum("nkc,pk->pnc", self.coefficients(coordinates)[0], self.polynomials(cases))

    @torch.no_grad()
    def start_from(self, samples: Samples) -> None:
        """Set the linear part to the least-squares fit of `samples`, the last layer of the deep part to zero."""
        modes = self.coordinates(samples.points_mm, order=0)[0].double()
        modes = torch.cat([torch.ones(len(modes), 1, dtype=torch.double), modes], dim=1)
        polynomials = self.polynomials(torch.from_numpy(samples.cases.values))
        design = torch.einsum("nk,nm->nkm", polynomials.double(), modes).flatten(1)
        roughness = torch.cat([torch.zeros(1), self.eigenvalues.double() / self.eigenvalues.max()]).square() + FLOOR
        growth = GROWTH ** self._orders.double()
        ridge = RIDGE * len(modes) * torch.outer(growth, roughness).flatten()
        normal = design.T @ design + torch.diag(ridge)
        fitted = torch.linalg.solve(normal, design.T @ torch.from_numpy(samples.displacements_mm))
        weights = fitted.view(len(growth), -1, 2).transpose(1, 2).flatten(0, 1)  # row 2 k + component
        weights /= self.decay.double().repeat_interleave(2)[:, None]
        self.linear.bias.copy_(weights[:, 0])
        self.linear.weight.copy_(weights[:, 1:])
        last = self.deep[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
