"""The truth that finite elements are measured against: a much finer mesh, and the whole body pulled a little across.

Half a body cannot lean to a side, and a mesh cannot tell its own error. The whole one, with a pull across that is next
to nothing, leans where it gives way; it has a mesh of its own.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import LabError
from pgdl_lab.mechanics.finger import STANDARD_GRAVITY_M_S2, Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.studies.stability.outcome import GOOD

Array = NDArray[np.float64]

EDGE_MM = 2.2
"""With it a finger of two chambers has 13 times as many elements as with 6 mm, and lies within 0.3 % of 1.5 mm."""
WHOLE_EDGE_MM = 4.4
ELEMENT = "hex27_p1"
PULL = 1e-4
"""Of the weight, across: what does not give way leans by about so much of its bending."""
NEWTON_MM, BETWEEN_MM = 1e-6, 0.1


@dataclass(frozen=True)
class State:
    """An equilibrium at the highest pressure.

    Attributes
    ----------
    model
        What it was found with.
    displacement
        (N, 3) of its nodes [mm].
    unstable
        Whether some equilibrium on the way there is not a minimum of the energy.
    """

    model: Model
    displacement: Array
    unstable: bool

    def at(self, points: Array) -> Array:
        """Displacement (N, 3) [mm] of undeformed `points` (N, 3) [mm]."""
        parts = np.array_split(points, max(1, len(points) // 200))
        probes = [self.model.discretisation.basis.probes(part.T) for part in parts]
        return np.concatenate([np.asarray(probe @ self.displacement) for probe in probes])

    @property
    def touches(self) -> bool:
        """Whether surfaces are within reach of each other."""
        contact = self.model.contact
        return bool(contact.active and contact.near(self.displacement))

    @property
    def lean(self) -> float:
        """How far the plane y = 0 has moved across, relative to the largest displacement."""
        between = np.isclose(self.model.discretisation.positions[:, 1], 0)
        largest = np.linalg.norm(self.displacement, axis=1).max()
        return float(np.abs(self.displacement[between, 1]).max() / largest)


@dataclass(frozen=True)
class Truth:
    """What is true of a scene.

    Attributes
    ----------
    fine
        Of half the body where the load is symmetric, whether it gives way to a side or not.
    whole
        Of the whole body, on a coarser mesh; the same as `fine` where the load is not symmetric.
    """

    fine: State
    whole: State

    @property
    def leans(self) -> bool:
        """Whether it gives way to a side."""
        return self.whole is not self.fine and self.whole.lean > GOOD

    @property
    def unstable(self) -> bool:
        """Whether it gives way, to a side or in its plane."""
        return self.leans or self.fine.unstable

    def at(self, points: Array) -> Array:
        """Displacement (N, 3) [mm] of undeformed `points` (N, 3) [mm]."""
        return (self.whole if self.leans else self.fine).at(points)


def truth_of(finger: Finger, edge_mm: float, contact: str) -> Truth | None:
    """The truth of a finger; None where there is no equilibrium at its highest pressure.

    Parameters
    ----------
    edge_mm
        Edges of the finer mesh [mm].
    contact
        "auto" or "on", see `Model`.
    """
    fine = _state(finger, edge_mm, contact)
    whole = fine
    if finger.planar:
        whole = _state(replace(finger, gravity_m_s2=_leaning(finger)), WHOLE_EDGE_MM, contact)
    return None if fine is None or whole is None else Truth(fine, whole)


def _state(finger: Finger, edge_mm: float, contact: str) -> State | None:
    model = Model(finger, edge_mm, ELEMENT, contact)
    try:
        history = model.load(np.array([finger.max_kpa]), NEWTON_MM, BETWEEN_MM)
    except LabError:
        return None
    if not history.complete:
        return None
    return State(model, history.at(finger.max_kpa), bool(history.unstable_kpa))


def _leaning(finger: Finger) -> list[float]:
    x, _, z = (1e-3 * finger.gravity_mm_s2).tolist()
    return [x, PULL * (float(np.hypot(x, z)) or STANDARD_GRAVITY_M_S2), z]
