"""A field that follows a guide, and a network that moves and turns the sections of the finger further."""

from __future__ import annotations

import copy
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.field import Field
from pgdl_lab.learning.jet import ROWS, XX, XZ, ZZ, X, Z, propagate
from pgdl_lab.learning.modal import DECAY
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.last_layer import ridge_regression
from pgdl_lab.surrogate.limits import BEYOND
from pgdl_lab.surrogate.triangulation import Triangulation

MOTIONS = 3  # of a section: along x, along z, and a turn in the plane


class GuidedField(Field):
    """u(x, z, p) = g + s Σ (a_k + b_k J (X + g)) T_k(p): g of the guide, a and b of a network of s; T_k of Chebyshev.

    s is the distance from the clamp along x by the length of the finger. What a cheap model of the mechanics errs by is
    for the most part how far each section of the slender body has moved and turned: two lengths a [mm] and an angle b
    [rad], which J = (0, −1; 1, 0) turns the place X + g by. They vary slowly along the finger, so that a small network
    learns them from few points, and with the pressure as a polynomial of low degree, which goes on beyond the trained
    ones. The clamp is held exactly; at the start they are zero.

    Parameters
    ----------
    points_mm, triangles
        (N, 2) [mm] and (T, 3), the undeformed body; the clamp lies at its least x.
    guide
        (N, D, 2), see `pgdl_lab.learning.guide.guide` [mm].
    range_kpa
        (2,), pressures that are mapped to −1 and 1 [kPa].
    deep
        The network, from (…, 1) to (…, 3 (K + 1)).
    """

    points_mm: Tensor
    triangles: Tensor
    guide: Tensor
    range_kpa: Tensor
    size_mm: Tensor

    def __init__(
        self, points_mm: Tensor, triangles: Tensor, guide: Tensor, range_kpa: Tensor, deep: nn.Sequential
    ) -> None:
        super().__init__()
        self.register_buffer("points_mm", points_mm)
        self.register_buffer("triangles", triangles)
        self.register_buffer("guide", guide)
        self.register_buffer("range_kpa", range_kpa)
        self.register_buffer("size_mm", torch.ones((), dtype=torch.double))  # of a and, by the length, of b
        self.deep = deep.double()
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    @torch.no_grad()
    def scale_to(self, samples: Samples) -> None:
        """Let the network begin with outputs of the size of what the guide errs by."""
        self.size_mm.fill_(np.sqrt((self._unguided_mm(samples) ** 2).mean()))

    @property
    def last(self) -> nn.Linear:
        """The last layer."""
        layer = self.deep[-1]
        assert isinstance(layer, nn.Linear)
        return layer

    @property
    def corrects(self) -> bool:
        """Whether the network adds anything to the guide."""
        return any(bool(weight.any()) for weight in self.last.parameters())

    @torch.no_grad()
    def without_network(self) -> GuidedField:
        """The same field with a network that adds nothing."""
        alone = copy.deepcopy(self)
        nn.init.zeros_(alone.last.weight)
        nn.init.zeros_(alone.last.bias)
        return alone

    @torch.no_grad()
    def shifts_mm(self, samples: Samples, kept: NDArray[np.bool_]) -> NDArray[np.float64]:
        """How much less (n, 2) the network would move the samples [mm], fitted to those alone that are `kept` (n,).

        Only the last layer is fitted anew, by ridge regression.
        """
        if not self.corrects:
            return np.zeros_like(samples.displacements_mm)
        design = self._design(samples)
        present = torch.cat([self.last.weight, self.last.bias[:, None]], dim=1).numpy().reshape(-1, 1)
        unguided_mm = self._unguided_mm(samples)[kept].reshape(-1, 1)
        _, weights, _ = ridge_regression(design[kept].reshape(len(unguided_mm), -1), unguided_mm)
        return (design @ (present - weights))[..., 0]

    @cached_property
    def body(self) -> Triangulation:
        """The undeformed body."""
        return Triangulation(self.points_mm.cpu().numpy(), self.triangles.cpu().numpy())

    def coordinates(self, points_mm: NDArray[np.float64], order: int) -> Tensor:
        """Place and coefficients of the guide: (J, n, 2 + 2 D)."""
        nodal = torch.cat([self.points_mm, self.guide.flatten(1)], dim=1).cpu().numpy()
        corners, weights = self.body.locate(points_mm)
        tables = [nodal, *(matrix @ nodal for matrix in self.body.derivatives[: ROWS[order] - 1])] if order else [nodal]
        return torch.from_numpy(np.stack([np.einsum("nc,ncm->nm", weights, table[corners]) for table in tables]))

    def rows(self, coordinates: Tensor, cases: Tensor) -> Tensor:
        pressures_kpa = cases[:, 0]
        place, guide = self._parts(coordinates, pressures_kpa)
        outputs = torch.unflatten(propagate(self.deep, self._inputs(coordinates)), -1, (MOTIONS, -1))
        motions = self._arms(coordinates, torch.einsum("jnmk,nk->jnm", outputs, self._orders(pressures_kpa)))
        x, z = (place + guide).unbind(dim=-1)
        turned = torch.stack([-product(motions[..., 2], z), product(motions[..., 2], x)], dim=-1)
        return guide + motions[..., :2] + turned / self._length_mm

    def _parts(self, coordinates: Tensor, pressures_kpa: Tensor) -> tuple[Tensor, Tensor]:
        """Place [mm] and displacement by the guide [mm] with their derivatives, (J, n, 2) each."""
        place, guide = coordinates[..., :2], torch.unflatten(coordinates[..., 2:], -1, (-1, 2))
        return place, torch.einsum("jndc,nd->jnc", guide, self._polynomials(pressures_kpa, guide.shape[2]))

    def _inputs(self, coordinates: Tensor) -> Tensor:
        """(J, n, 1), s as the network sees it, from −1 to 1, with its derivatives by place."""
        share = 2 * self._share(coordinates)
        return torch.cat([share[:1] - 1, share[1:]])[..., None]

    def _orders(self, pressures_kpa: Tensor) -> Tensor:
        """(n, K + 1), polynomials in the pressure that the outputs of the network are coefficients of."""
        count = self.last.out_features // MOTIONS
        return self._polynomials(pressures_kpa, count) * DECAY ** torch.arange(count).to(pressures_kpa)

    def _arms(self, coordinates: Tensor, outputs: Tensor) -> Tensor:
        """What `outputs` (J, n, …) of the network are worth at s, in the size of the guide's error [mm]."""
        return self.size_mm * product(self._share(coordinates)[..., None], outputs)

    def _share(self, coordinates: Tensor) -> Tensor:
        """(J, n), s and its derivatives."""
        x = coordinates[..., 0]
        return torch.cat([x[:1] - self.points_mm[:, 0].min(), x[1:]]) / self._length_mm

    @property
    def _length_mm(self) -> Tensor:
        return self.points_mm[:, 0].max() - self.points_mm[:, 0].min()

    def _polynomials(self, pressures_kpa: Tensor, count: int) -> Tensor:
        return torch.stack(Basis.of([self.range_kpa.tolist()], count - 1).terms([pressures_kpa]), dim=-1)

    @torch.no_grad()
    def nodal(self) -> NDArray[np.float64]:
        """(N, D, 2), the coefficients that `guide` would have if it said what this field says [mm]."""
        degree, high = self.guide.shape[1] - 1, float(self.range_kpa[1])
        # Chebyshev points up to where it may be asked
        kpa = BEYOND * high * (1 - np.cos(np.pi * (np.arange(4 * degree) + 0.5) / (4 * degree))) / 2
        fields = self.displacements(self.coordinates(self.points_mm.cpu().numpy(), 0), torch.from_numpy(kpa[:, None]))
        polynomials = Basis.of([self.range_kpa.tolist()], degree)(kpa)
        fitted = np.linalg.lstsq(polynomials, fields.cpu().numpy().reshape(len(kpa), -1))[0]
        return fitted.reshape(degree + 1, -1, 2).transpose(1, 0, 2)

    def _unguided_mm(self, samples: Samples) -> NDArray[np.float64]:
        """What the guide alone leaves (n, 2) of the displacement of the samples [mm]."""
        coordinates = self.coordinates(samples.points_mm, 0)
        _, guide = self._parts(coordinates, torch.from_numpy(samples.pressures_kpa))
        return samples.displacements_mm - guide[0].numpy()

    def _design(self, samples: Samples) -> NDArray[np.float64]:
        """(n, 2, 3 (K + 1) H), by which the weights of the last layer [–] move the points [mm]."""
        coordinates, pressures_kpa = self.coordinates(samples.points_mm, 0), torch.from_numpy(samples.pressures_kpa)
        hidden = self.deep[:-1](self._inputs(coordinates))
        hidden = self._arms(coordinates, torch.cat([hidden, torch.ones_like(hidden[..., :1])], dim=-1))[0]
        place, guide = self._parts(coordinates, pressures_kpa)
        x, z = ((place + guide)[0] / self._length_mm).unbind(dim=-1)
        none, one = torch.zeros_like(x), torch.ones_like(x)
        basis = torch.stack([torch.stack([one, none, -z], -1), torch.stack([none, one, x], -1)], dim=1)
        return torch.einsum("nim,nk,nh->nimkh", basis, self._orders(pressures_kpa), hidden).flatten(2).numpy()


def product(left: Tensor, right: Tensor) -> Tensor:
    """Rows (J, …) of a product from those of its factors, see `Jet`."""
    rows = [left[0] * right[0]]
    if len(left) > 1:
        rows += [left[i] * right[0] + left[0] * right[i] for i in (X, Z)]
    if len(left) == ROWS[2]:
        pairs = {XX: (X, X), ZZ: (Z, Z), XZ: (X, Z)}
        rows += [
            left[i] * right[0] + left[0] * right[i] + left[first] * right[second] + left[second] * right[first]
            for i, (first, second) in pairs.items()
        ]
    return torch.stack(rows)
