"""Settings of a chart: the group `chart` of `conf/task/chart.yaml`."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation


@dataclass(frozen=True)
class ChartSettings:
    """What a chart compares and how long it may take.

    Attributes
    ----------
    reference
        The finite-element model that the reference is extrapolated from: its name and fields; its `edge_mm` is the
        longest edge of the coarser of two meshes, the other has half of that [mm].
    judged
        Number of equal pressure steps at which errors are judged; lowered to the next divisor of
        `observation.snapshots`.
    meshes
        Longest edges of the finite-element models, as multiples of their defaults.
    protocols
        Experiments whose model and training are methods too, such as that of the paper.
    protocol_s
        Time budgets of each of them [s].
    queries
        Number of queries that the times from end to end are made up for.
    train_s
        Longest training of a model [s]; its own budget counts where that is less.
    longest_s
        A program outside this one is stopped after this time, and a mesh that is expected to take longer by what
        coarser ones took is left out [s].
    """

    reference: dict[str, Any] = field(default_factory=dict)
    judged: int = 5
    meshes: list[float] = field(default_factory=lambda: [2.0, 1.0])
    protocols: list[str] = field(default_factory=list)
    protocol_s: list[float] = field(default_factory=list)
    queries: int = 1000
    train_s: float = 100.0
    longest_s: float = 500.0

    def __post_init__(self) -> None:
        for name in ("train_s", "longest_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"chart.{name} is {getattr(self, name)} s; it must be above 0.")
        for name in ("judged", "queries"):
            if getattr(self, name) < 1:
                raise InputError(f"chart.{name} is {getattr(self, name)}; it must be at least 1.")
        for name in ("meshes", "protocol_s"):
            if not all(0 < value < np.inf for value in getattr(self, name)):
                raise InputError(f"chart.{name} is {list(getattr(self, name))}; give numbers above 0.")
        if not isinstance(self.reference.get("name"), str):
            raise InputError("chart.reference names no finite-element model: set chart.reference.name=solid.")

    def quick(self) -> "ChartSettings":
        """The same on meshes twice as coarse and with trainings of seconds."""
        doubled = {**self.reference, "edge_mm": 2 * self.reference["edge_mm"]}
        return replace(
            self, reference=doubled, meshes=[2.0], protocol_s=self.protocol_s[:1], train_s=8.0, longest_s=20.0
        )

    def judgement(self, observation: Observation) -> Observation:
        """The pressures at which errors are judged, on the points of `observation`."""
        steps = next(n for n in range(min(self.judged, observation.snapshots), 0, -1) if observation.snapshots % n == 0)
        return Observation(snapshots=steps, points=observation.points)
