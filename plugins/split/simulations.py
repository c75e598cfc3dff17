"""Split `simulations`: whole simulations held out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import register
from pgdl_lab.core.split import Split


@register("split", "simulations")
@dataclass(frozen=True)
class SimulationsSplit(Split):
    """Points drawn at random from some simulations; all others are held out.

    How far a surrogate errs at inputs that nobody simulated is told by whole simulations that it has not seen: points
    of one simulation know each other.

    Attributes
    ----------
    held_out
        Share of the simulations that are held out, at least one.
    draw
        Another number draws others.
    """

    held_out: float = 0.2
    draw: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.held_out < 1:
            raise InputError(f"split.held_out is {self.held_out}; it must lie between 0 and 1.")
        if self.draw < 0:
            raise InputError(f"split.draw is {self.draw}; it must not be negative.")

    def seen(self, cases: Cases) -> NDArray[np.bool_]:
        known = np.unique(cases.simulation)
        if len(known) < 2:
            raise InputError("The data hold one simulation, of which none can be held out: choose split=random.")
        count = min(max(1, round(self.held_out * len(known))), len(known) - 1)
        held = np.random.default_rng(self.draw).choice(known, count, replace=False)
        return ~np.isin(cases.simulation, held)
