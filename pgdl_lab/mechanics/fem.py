"""The plugin kind `fem`: a finite-element model that turns a finger into snapshots."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab import __version__
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.finger import Finger

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)


class SimulationStopped(LabError):
    """No equilibrium was found beyond some pressure.

    Attributes
    ----------
    snapshots
        What converged; may hold no snapshot at all.
    """

    def __init__(self, message: str, snapshots: Dataset) -> None:
        super().__init__(message)
        self.snapshots = snapshots


@dataclass(frozen=True)
class Fem(ABC):
    """A finite-element model of a finger under gravity and rising pressure."""

    def programs(self) -> Mapping[str, str]:
        """Programs beside Python that it runs, and their versions: results are kept under them too."""
        return {}

    @abstractmethod
    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        """Compute the observed displacements of `finger`.

        Raises
        ------
        InputError
            When finger and model do not fit together.
        SimulationStopped
            When the finger cannot bear the highest pressure; carries the snapshots that converged.
        """

    def dataset(
        self,
        finger: Finger,
        face: Face,
        pressures_kpa: Array,
        displacements: Sequence[Array],
        provenance: Mapping[str, Any],
        *,
        body: Dataset | None = None,
        warnings: Iterable[str] = (),
        trouble: str = "",
    ) -> Dataset:
        """What was found, as every model hands it out.

        Parameters
        ----------
        pressures_kpa
            (P,) those with an equilibrium, rising [kPa].
        displacements
            u_x and u_z at the points of `face` (N, 2) [mm], for each of them.
        provenance
            What is to be known of the simulation, besides finger and model.
        body
            The whole body at the equilibria that were solved for.
        warnings
            Sentences on what may be wrong with it.
        trouble
            Why the highest pressure was not reached; empty if it was.

        Raises
        ------
        SimulationStopped
            When there was `trouble`.
        """
        own = {"finger": describe(finger), "fem": describe(self)}
        versions = {"versions": {**provenance.get("versions", {}), "pgdl_lab": __version__}}
        observed = np.array(displacements).reshape(-1, len(face.domain.points_mm), 2)
        result = Dataset.path(
            face.domain, pressures_kpa, observed, body=body, provenance={**own, **provenance, **versions}
        )
        for sentence in warnings:
            _log.warning("%s", sentence)
        if trouble:
            raise SimulationStopped(trouble, result)
        return result

    def refuse_further_loads(self, finger: Finger) -> None:
        """Raise InputError when more acts on `finger` than its weight and one pressure."""
        acting = {name for schedule in finger.schedules() for name in schedule.at(1.0)}
        if further := sorted(acting - {"weight", "air"}):
            raise InputError(
                f"fem={describe(self)['name']} knows weight and one pressure alone, and "
                f"finger={describe(finger)['name']} also has {', '.join(further)}: choose fem=solid."
            )
