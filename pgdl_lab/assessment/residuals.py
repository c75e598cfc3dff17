"""What each loss term makes of the simulated displacement and of the surrogate's."""

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.learning.jet import ROWS, Jet
from pgdl_lab.learning.loss import Loss
from pgdl_lab.learning.scene import Scene
from pgdl_lab.surrogate.triangulation import Triangulation

Floats = NDArray[np.float64]


def residuals(
    losses: Mapping[str, Loss], scene: Scene, snapshots: Dataset, predicted_mm: Floats, which: NDArray[np.int64]
) -> dict[str, dict[str, float]]:
    """Unweighted terms, for both fields from their values at the points of the domain and by the same formulas.

    What a term makes of the simulated displacement is its floor: a surrogate that is pushed below it is pushed away
    from the truth. Where the floor is above what the term makes of no displacement at all, the term draws to rest.
    Derivatives are those of quadratics fitted to the values around each point, see `Triangulation.derivatives`, so that
    the floor also carries what these miss at sharp corners.

    Parameters
    ----------
    losses
        Terms by name.
    scene
        The body.
    snapshots
        The simulation.
    predicted_mm
        (P, N, d), the surrogate's displacements [mm].
    which
        Indices of the snapshots over which the terms are averaged.

    Returns
    -------
    For each term "fem", "surrogate" and "rest" (no displacement), each in the term's own unit.
    """
    body = Triangulation.of(snapshots.domain)
    rest = np.zeros_like(predicted_mm)
    fields = {"fem": snapshots.displacements, "surrogate": predicted_mm, "rest": rest}
    found: dict[str, dict[str, float]] = {}
    for name, loss in losses.items():
        own = loss.own_points(scene)
        placed = None if own is None else body.locate(own[0])  # None: at the points of the domain
        matrices = body.derivatives[: ROWS[loss.order] - 1] if loss.order else []
        found[name] = dict.fromkeys(fields, 0.0)
        for who, field in fields.items():
            for i in which:
                rows = np.stack([field[i], *(matrix @ field[i] for matrix in matrices)])
                if placed is not None:
                    corners, weights = placed
                    rows = np.einsum("nc,rnci->rni", weights, rows[:, corners])
                target = torch.from_numpy(snapshots.displacements[i] if own is None else own[1])
                pressures = torch.full((len(target),), float(snapshots.pressures_kpa[i]), dtype=target.dtype)
                value = loss.value(Jet(torch.from_numpy(rows), pressures), target, scene)
                found[name][who] += float(value) / len(which)
    return found
