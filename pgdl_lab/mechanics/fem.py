"""The plugin kind `fem`: a finite-element model that turns a finger into snapshots."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.finger import Finger


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
