"""What the models below the three-dimensional solid share: the finger they can take and the way to snapshots."""

import logging
import time
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab import __version__
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.fem import Fem, SimulationStopped
from pgdl_lab.mechanics.finger import ExtrudedFinger, Finger
from pgdl_lab.mechanics.finite_strain import Model

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)


class ReducedModel(Model):
    """A model with unknowns of its own, whose `equilibrium` and `solver` the load path of the solid can use."""

    @abstractmethod
    def observer(self, face: Face) -> Callable[[Array, float], Array]:
        """Function from the unknowns (M, 3) and the pressure [kPa] to u_x and u_z at `face` (N, 2) [mm]."""

    @abstractmethod
    def size(self) -> dict[str, Any]:
        """How large the model is, for the provenance."""

    def touches(self, state: Array, kpa: float) -> bool:
        """Whether chambers touch each other at its unknowns (M, 3) and a pressure [kPa], as far as it knows."""
        return False

    def doubts(self) -> list[str]:
        """Why this finger is none that the model is made for, in sentences."""
        return []


def require_profile(finger: Finger, fem: Fem) -> ExtrudedFinger:
    """`finger`, if it has a profile; raises InputError."""
    if not isinstance(finger, ExtrudedFinger):
        raise InputError(
            f"fem={describe(fem)['name']} is made from the x–z profile of a finger, and "
            f"finger={describe(finger)['name']} has none: choose fem=solid."
        )
    if not finger.planar:
        raise InputError(
            f"fem={describe(fem)['name']} moves in the x–z plane alone, and finger.gravity_m_s2 is "
            f"{list(finger.gravity_m_s2)}: choose fem=solid, or leave out the part along y."
        )
    return finger


def simulate(
    make: Callable[[ExtrudedFinger], ReducedModel],
    fem: Fem,
    finger: Finger,
    observation: Observation,
    tolerances_mm: tuple[float, float],
    caution: str,
) -> Dataset:
    """Snapshots of `finger` by the model that `make` returns.

    Parameters
    ----------
    tolerances_mm
        Of each equilibrium, and of what is interpolated between them [mm].
    caution
        What the model leaves out: its error is unknown, so every simulation warns of it.

    Raises
    ------
    InputError
        When the finger has no profile, or gravity pulls it along y.
    SimulationStopped
        When the model finds no equilibrium at the highest pressure.
    """
    began = time.perf_counter()
    face, model = finger.face(observation.points), make(require_profile(finger, fem))
    made = time.perf_counter()
    pressures = observation.pressures_kpa(finger.max_kpa)
    history = model.load(pressures, *tolerances_mm)
    solved = time.perf_counter()
    pressures = pressures[pressures <= history.reached_kpa * (1 + 1e-12)]
    observe = model.observer(face)
    displacements = np.array([observe(history.at(kpa), float(kpa)) for kpa in pressures])
    ended = time.perf_counter()
    snapshots = Dataset.path(
        face.domain,
        pressures,
        displacements.reshape(-1, len(face.domain.points_mm), 2),
        provenance={
            "finger": describe(finger),
            "fem": describe(fem),
            "mesh": model.size() | {"degrees_of_freedom": int(model.equilibrium.free.sum())},
            "equilibria_kpa": history.branch.parameters,
            "newton_iterations": history.iterations,
            "interpolation_error_mm": history.interpolation_mm,
            "unstable_kpa": history.unstable_kpa,
            "limit_kpa": history.limit_kpa,
            "linear_solver": model.solver.name,
            "versions": {"pgdl_lab": __version__},
            "seconds_of": {"model": made - began, "equilibria": solved - made, "snapshots": ended - solved},
            "seconds": ended - began,
        },
    )
    for sentence in (f"{caution} Compare with fem=solid if that matters.", *model.doubts()):
        _log.warning("%s", sentence)
    touching = [kpa for kpa in [0.0, *pressures.tolist()] if model.touches(history.at(kpa), kpa)]
    if touching:
        _log.warning(
            "Surfaces pass through each other at %.4g kPa and more, as fem=%s leaves contact out: choose fem=solid.",
            touching[0],
            describe(fem)["name"],
        )
    if history.unstable_kpa:
        _log.warning("The equilibria at %s kPa are unstable: the finger would snap through.", history.unstable_kpa)
    if not history.complete:
        raise SimulationStopped(
            f"{history.ending(finger, len(pressures), observation.snapshots)} Lower the pressure, thicken the walls or "
            "choose fem=solid.",
            snapshots,
        )
    return snapshots
