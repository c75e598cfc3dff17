"""What the models below the three-dimensional solid share: the finger they can take and the way to snapshots."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import ExtrudedFinger, Finger
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.loading import History, load

Array = NDArray[np.float64]


class ReducedModel(ABC):
    """A model of a finger with unknowns of its own.

    Parameters
    ----------
    finger
        What is modelled.
    equilibrium
        What balances, by these unknowns, with the loads "weight" and "air".
    """

    def __init__(self, finger: ExtrudedFinger, equilibrium: Equilibrium) -> None:
        self.finger, self.equilibrium, self.solver = finger, equilibrium, symmetric_solver()

    def load(self, pressures_kpa: Array, newton_mm: float, interpolation_mm: float) -> History:
        """Put on the weight, then raise the pressure; see `loading.load`."""
        return load(self.equilibrium, self.solver, self.finger.schedules(), pressures_kpa, newton_mm, interpolation_mm)

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
    """`finger`, if it has a profile, and no loads but its weight and one pressure; raises InputError."""
    fem.refuse_further_loads(finger)
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
    pressures = history.reached(pressures)
    observe = model.observer(face)
    displacements = [observe(history.at(kpa), float(kpa)) for kpa in pressures]
    ended = time.perf_counter()
    warnings = [f"{caution} Compare with fem=solid if that matters.", *model.doubts()]
    touching = [kpa for kpa in [0.0, *pressures.tolist()] if model.touches(history.at(kpa), kpa)]
    if touching:
        warnings.append(
            f"Surfaces pass through each other at {touching[0]:.4g} kPa and more, as fem={describe(fem)['name']} "
            "leaves contact out: choose fem=solid."
        )
    return fem.dataset(
        finger,
        face,
        pressures,
        displacements,
        {
            "mesh": model.size() | {"degrees_of_freedom": int(model.equilibrium.free.sum())},
            "linear_solver": model.solver.name,
            "seconds_of": {"model": made - began, "equilibria": solved - made, "snapshots": ended - solved},
            "seconds": ended - began,
            **history.provenance(),
        },
        warnings=[*warnings, *history.warnings()],
        trouble=history.trouble(finger, len(pressures), observation.snapshots, "thicken the walls or choose fem=solid"),
    )
