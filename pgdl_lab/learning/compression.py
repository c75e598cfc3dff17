"""Fewer modes for a surrogate that is as good."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.calibration import NORMAL
from pgdl_lab.surrogate.limits import BEYOND

LEFT_OUT = 0.1  # a tenth of the error adds half a per cent to it


def compressed(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The state of a `NodalSurrogate` with no more modes than tell its field apart from what is not known of it.

    The modes are those of a singular value decomposition over all nodes and all pressures up to `BEYOND` times the
    highest trained one, and as far along other inputs: of as many modes no others come closer to the field. What is
    left out is at most the noise, which every error bar holds, and at most `LEFT_OUT` of the posterior's standard
    deviation within the trained pressures, all as root mean squares.
    """
    amplitudes, modes, spread = (state[name].numpy() for name in ("amplitudes", "modes", "spread"))
    basis = Basis.restored({name: array.numpy() for name, array in state.items()}, len(amplitudes))
    coefficients = np.einsum("dk,nkc->dnc", amplitudes, modes).reshape(len(amplitudes), -1)
    cases = _everywhere(basis)
    polynomials = basis(cases)
    roots = spread.transpose(1, 0, 2).reshape(len(amplitudes), -1)
    known = polynomials[(cases <= np.array(basis.ranges)[:, 1]).all(axis=1)] @ roots
    deviation_mm = np.sqrt((known.astype(float) ** 2).sum() / len(known) / len(modes))
    _, root = np.linalg.qr(polynomials)
    left, sizes, right = np.linalg.svd(root @ coefficients, full_matrices=False)
    rest_mm = np.sqrt(np.cumsum(sizes[::-1] ** 2)[::-1] / len(cases) / coefficients.shape[1])  # from each on
    # what bars make of the standard deviations
    scale = min(1.0, float(state["bar_deviations"].min()) / NORMAL) if "bar_deviations" in state else 1.0
    most_mm = scale * min(float(state["noise_mm"]), LEFT_OUT * deviation_mm)
    count = max(1, int((rest_mm > most_mm).sum()))
    size = np.sqrt(coefficients.shape[1])  # modes of unit root mean square: the amplitudes carry the unit
    kept = size * right[:count].reshape(count, *modes.shape[::2]).transpose(1, 0, 2)
    amplitudes_mm = np.linalg.solve(root, left[:, :count] * sizes[:count]) / size
    return {**state, "modes": torch.from_numpy(kept.copy()), "amplitudes": torch.from_numpy(amplitudes_mm.copy())}


def _everywhere(basis: Basis) -> NDArray[np.float64]:
    """Cases (n, D), as many for each polynomial, up to the highest that are answered; evenly for one input."""
    low, high = np.array(basis.ranges).T
    far, count = low + BEYOND * (high - low), 10 * len(basis.degrees)
    if len(low) == 1:
        return np.linspace(low, far, count)
    return np.random.default_rng(0).uniform(low, far, (count, len(low)))
