"""The plugin kind `fem`: a finite-element model that turns a finger into snapshots."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from pgdl_lab.finger import Finger
from pgdl_lab.snapshots import Observation, Snapshots


@dataclass(frozen=True)
class Fem(ABC):
    """A finite-element model of a finger under gravity and rising pressure."""

    @abstractmethod
    def simulate(self, finger: Finger, observation: Observation) -> Snapshots:
        """Compute the observed displacements of `finger`.

        Raises
        ------
        SimulationStopped
            When no equilibrium is found beyond some pressure; carries the snapshots that converged.
        """
