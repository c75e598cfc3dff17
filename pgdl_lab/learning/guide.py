"""What a cheap model of the finger says before any data are seen: it guides a surrogate that is trained on few points.

A model of the finger's mechanics knows its weight, its air and its shape at every pressure, also where there are no
data. What it errs by is far smaller and smoother than the displacement, so that a few points tell it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.separable import SeparableRegression, evaluated
from pgdl_lab.mechanics.fem import SimulationStopped
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.limits import BEYOND
from pgdl_lab.surrogate.triangulation import Triangulation

Floats = NDArray[np.float64]

TRIED = 2500  # samples that the early test looks at
STRIPS = 3  # parts of the body that these come from: root, middle and tip
INNER = 0.8  # of each is judged: at its edges neighbours are missing
LEFT_OUT = 0.15  # share of the nodes that are left out for it


@lru_cache(maxsize=4)
def guide(scene: Scene, name: str, highest_kpa: float, degree: int) -> Floats:
    """What the model `name` of kind `fem` says of the face at its nodes.

    It is asked for pressures up to `BEYOND` times the highest trained one, or as far as it goes.

    Returns
    -------
    (N, degree + 1, 2), coefficients of Chebyshev polynomials in the pressure, 0 and `highest_kpa` mapped to −1 and 1
    [mm].

    Raises
    ------
    LabError
        When it cannot be asked about this finger, or not up to `highest_kpa`.
    """
    if scene.finger is None:
        raise InputError("the finger behind the data is not known")
    given: Any = scene.finger
    observation = Observation(2 * (degree + 1), len(scene.domain.points_mm))
    with _unheard():
        try:
            found = plugin("fem", name)().simulate(replace(given, max_kpa=BEYOND * highest_kpa), observation)
        except SimulationStopped as stop:
            found = stop.snapshots
            if len(found.pressures_kpa) <= degree or found.pressures_kpa[-1] < highest_kpa:
                raise
    polynomials = Basis.of([(0.0, highest_kpa)], degree)(found.pressures_kpa)
    coefficients: Floats = np.linalg.lstsq(polynomials, found.displacements.reshape(len(polynomials), -1))[0]
    nodal = coefficients.reshape(degree + 1, -1, 2).transpose(1, 0, 2)
    if not np.array_equal(found.domain.points_mm, scene.domain.points_mm):
        corners, weights = Triangulation(found.domain.points_mm, found.domain.cells).locate(scene.domain.points_mm)
        nodal = np.einsum("nc,ncdi->ndi", weights, nodal[corners])
    return np.ascontiguousarray(nodal)


@contextmanager
def _unheard() -> Iterator[None]:
    """Keep what the mechanics warn of to itself: how far a guide errs is learnt."""
    logger = logging.getLogger("pgdl_lab.mechanics")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def gains(scene: Scene, samples: Samples, nodal: Floats, degree: int, rng: np.random.Generator) -> bool:
    """Whether a closed form errs less when the guide `nodal` (N, D, 2), see `guide`, helps it than alone.

    The early test, of a small part of the time that the closed form takes: on strips of the body that hold some `TRIED`
    samples, as densely as all lie, it leaves out nodes with all their samples and looks how far off they are told.
    """
    high_kpa = float(samples.pressures_kpa.max())
    share = min(1.0, TRIED / len(samples))

    def from_middle(points_mm: Floats) -> Floats:
        """Distance (m,) from the middle of a strip, 1 at its edges."""
        place = STRIPS * (points_mm[:, 0] - scene.domain.points_mm[:, 0].min()) / np.ptp(scene.domain.points_mm[:, 0])
        return 2 * np.abs(place % 1 - 0.5) / share

    triangles = scene.domain.cells[(from_middle(scene.domain.points_mm) <= 1)[scene.domain.cells].all(axis=1)]
    nodes, renumbered = np.unique(triangles, return_inverse=True)
    body, clamp = (
        Triangulation(scene.domain.points_mm[nodes], renumbered.reshape(-1, 3)),
        np.isin(nodes, scene.domain.clamp),
    )
    corners, weights = body.locate(samples.points_mm)
    seen = np.flatnonzero(body.distance_mm(samples.points_mm, corners, weights) <= body.tolerance_mm)
    nearest = corners[seen, weights[seen].argmax(axis=1)]
    left_out = (rng.random(len(nodes)) < LEFT_OUT)[nearest]
    judged = left_out & (from_middle(samples.points_mm[seen]) <= (INNER if share < 1 else 1))
    if left_out.all() or not judged.any():
        return True

    whole, kept, asked = (samples.at(which) for which in (seen, seen[~left_out], seen[judged]))
    guided_mm = whole.displacements_mm - evaluated(nodal[nodes], body, whole, high_kpa)

    def squared_error(targets_mm: Floats, rough: Floats | None) -> float:
        fitted = replace(kept, displacements_mm=targets_mm[~left_out])
        with closing(
            SeparableRegression(body, np.flatnonzero(clamp), fitted, Basis.of([(0.0, high_kpa)], order), rough)
        ) as regression:
            prior = regression.first_prior()
            posterior = regression.posterior(prior, 0, rng)
        coefficients = np.einsum("dk,nkc->ndc", prior.amplitudes, posterior.modes)
        return float(((evaluated(coefficients, body, asked, high_kpa) - targets_mm[judged]) ** 2).mean())

    order = degree if share < 1 else (degree + 1) // 2  # few samples do not tell high degrees
    return squared_error(guided_mm, nodal[nodes]) < squared_error(whole.displacements_mm, None)
