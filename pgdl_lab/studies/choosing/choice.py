"""What was chosen, why, and what it may err by."""

from dataclasses import dataclass, field
from typing import Any

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.registry import describe
from pgdl_lab.core.split import Split
from pgdl_lab.learning.model import Model
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.surrogate.surrogate import Surrogate


@dataclass
class Choice:
    """The least model found so far.

    Attributes
    ----------
    finger, fem
        What is simulated; gravity and material may be simpler than those asked for.
    expected_mm
        Estimated largest error of the finite-element model, with its margin of safety [mm].
    surrogate_mm
        Largest error of the surrogate against the data it was trained on, at points it was not given [mm].
    dropped_mm
        What simpler gravity, material and contact change [mm].
    met
        Whether the tolerance and the budgets are met.
    model, split, surrogate
        The surrogate, if one is needed.
    snapshots
        The simulation.
    reasons
        One line for each decision.
    spent_s
        Time of all simulations and trainings that were looked at [s]; those from the cache count as when they ran.
    """

    finger: Finger
    fem: Fem
    expected_mm: float = float("inf")
    surrogate_mm: float = 0.0
    dropped_mm: float = 0.0
    met: bool = False
    model: Model | None = None
    split: Split | None = None
    surrogate: Surrogate | None = None
    snapshots: Dataset | None = None
    reasons: list[str] = field(default_factory=list)
    spent_s: float = 0.0

    @property
    def error_mm(self) -> float:
        """Estimated largest error in all [mm]."""
        return self.expected_mm + self.surrogate_mm + self.dropped_mm

    def record(self) -> dict[str, Any]:
        """For choice.json."""
        result = self.surrogate or self.snapshots
        return {
            "met": self.met,
            "expected_error_mm": {
                "finite_elements": self.expected_mm,
                "surrogate": self.surrogate_mm,
                "left_out": self.dropped_mm,
                "all": self.error_mm,
            },
            "finger": describe(self.finger),
            "fem": describe(self.fem),
            "model": describe(self.model) if self.model else None,
            "split": describe(self.split) if self.split else None,
            "reasons": self.reasons,
            "warnings": result.warnings if result else [],
            "spent_s": self.spent_s,
        }
