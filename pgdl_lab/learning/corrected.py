"""A closed-form field with a small network that corrects it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.field import Field
from pgdl_lab.learning.jet import ROWS, propagate
from pgdl_lab.learning.separable import Prior, SeparableRegression
from pgdl_lab.learning.triangulation import Triangulation


class CorrectedField(Field):
    """u(x, p) = Σ modes(x) · amplitudes(p) + Σ c_k(x) T_k(p), the coefficients c from a network; T_k of Chebyshev.

    The network's inputs are the strongest modes of the closed form, coordinates that know the body and how it moves. It
    is zero where they are, at the clamp, and starts from zero everywhere.

    Parameters
    ----------
    closed_form
        The state of a `NodalSurrogate`.
    scale_mm
        (), size of the corrections [mm].
    deep
        The network, from (…, F) to (…, 2 (degree + 1)); F / 2 modes are its inputs.
    inputs, degree
        F, and the corrections' degree in the pressure.
    """

    modes: Tensor
    amplitudes: Tensor
    range_kpa: Tensor
    scale_mm: Tensor

    def __init__(
        self, closed_form: Mapping[str, Tensor], scale_mm: Tensor, deep: nn.Sequential, inputs: int, degree: int
    ) -> None:
        super().__init__()
        for name, tensor in closed_form.items():
            self.register_buffer(name, tensor)
        self.register_buffer("scale_mm", scale_mm)
        self.names = tuple(closed_form)
        self.deep = deep.double()
        self.inputs = inputs
        self.degree = degree
        last = deep[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    @cached_property
    def body(self) -> Triangulation:
        """The undeformed body."""
        points, triangles = (self.get_buffer(name).cpu().numpy() for name in ("points_mm", "triangles"))
        return Triangulation(points, triangles)

    def coordinates(self, points_mm: NDArray[np.float64], order: int) -> Tensor:
        modes = self.modes.cpu().flatten(1).numpy()
        corners, weights = self.body.locate(points_mm)
        tables = [modes, *(matrix @ modes for matrix in self.body.derivatives[: ROWS[order] - 1])] if order else [modes]
        return torch.from_numpy(np.stack([np.einsum("nc,ncm->nm", weights, table[corners]) for table in tables]))

    def rows(self, coordinates: Tensor, pressures_kpa: Tensor) -> Tensor:
        polynomials = self._polynomials(pressures_kpa)
        modes = torch.unflatten(coordinates, -1, (-1, 2))
        closed = torch.einsum("jnkc,nk->jnc", modes, polynomials @ self.amplitudes)
        return closed + torch.einsum("jnkc,nk->jnc", self.corrections(coordinates), polynomials[:, : self.degree + 1])

    def corrections(self, coordinates: Tensor) -> Tensor:
        """Coefficients (J, n, degree + 1, 2) [mm] of the correction and their derivatives, from coordinates."""
        features = coordinates[..., : self.inputs] / self._sizes
        at_clamp = self.deep(torch.zeros_like(features[0, :1]))
        rows = propagate(self.deep, features)
        rows = torch.cat([rows[:1] - at_clamp, rows[1:]])
        return self.scale_mm * torch.unflatten(rows, -1, (-1, 2))

    @property
    def _sizes(self) -> Tensor:
        """(F,), root mean squares of the inputs over the body [1]; the amplitudes carry the unit."""
        return self.modes.flatten(1)[:, : self.inputs].square().mean(dim=0).sqrt()

    def _polynomials(self, pressures_kpa: Tensor) -> Tensor:
        low, high = self.range_kpa
        t = (2 * pressures_kpa - low - high) / (high - low)
        columns = [torch.ones_like(t), t]
        while len(columns) < len(self.amplitudes):
            columns.append(2 * t * columns[-1] - columns[-2])
        return torch.stack(columns, dim=-1)

    @property
    def corrects(self) -> bool:
        """Whether the network adds anything to the closed form."""
        return any(bool(weight.any()) for weight in self.deep[-1].parameters())

    def prior(self) -> Prior:
        """What the closed form was found with, if all its modes are here."""
        amplitudes = self.amplitudes.cpu().numpy()
        return Prior(amplitudes @ amplitudes.T, float(self.get_buffer("noise_mm")))

    @torch.no_grad()
    def nodal(self) -> dict[str, Tensor]:
        """The state of a `NodalSurrogate` that is this field at the nodes and linear between them."""
        state = {name: self.get_buffer(name).cpu() for name in self.names}
        amplitudes = state["amplitudes"]
        # all in Chebyshev polynomials themselves, which the corrections add to
        coefficients = torch.einsum("dk,nkc->ndc", amplitudes, state["modes"])
        coefficients[:, : self.degree + 1] += self.corrections(self.modes.flatten(1)[None])[0].cpu()
        return {**state, "modes": coefficients, "amplitudes": torch.eye(len(amplitudes)).double()}


def cross_fitted(
    regression: SeparableRegression, prior: Prior, field: Mapping[str, Tensor], folds: int, rng: np.random.Generator
) -> tuple[Samples, float]:
    """Samples whose distance from the closed-form `field` is what it errs by where it has not seen the data.

    The closed form passes so close by its own data that a network has nothing to learn from the remainder. Hence every
    sample is predicted by a fit without it, and the error of that prediction is what the network is shown (stacked
    generalisation: D. Wolpert, 1992).

    Returns
    -------
    The samples and the root mean square of these errors per component [mm].
    """
    samples = regression.samples
    fold = rng.integers(folds, size=len(samples.pressures_kpa))
    error = np.empty_like(samples.displacements_mm)
    for held in (fold == number for number in range(folds)):
        mean, _ = regression.at_samples(regression.posterior(prior, 1, rng, kept=~held))
        error[held] = (samples.displacements_mm - mean)[held]
    whole = np.einsum("dk,nkc->ndc", field["amplitudes"].numpy(), field["modes"].numpy())[regression.free]
    local = (regression.hats @ whole.reshape(len(whole), -1)).reshape(len(error), -1, 2)
    mean = np.einsum("nd,ndc->nc", regression.polynomials, local)
    shown = Samples(samples.points_mm, samples.pressures_kpa, mean + error)
    return shown, float(np.sqrt((error**2).mean()))
