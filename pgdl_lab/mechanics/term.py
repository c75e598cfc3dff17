"""The terms of the potential energy, Π(u; a) = Σ a_k Φ_k(u), each with its vector and its matrix.

Stored energies, of the solid or of the barrier of contact, count once. A load counts by its amplitude: Φ is minus the
work that it does at an amplitude of 1, so −∂Φ/∂u are its forces. Schedules say how amplitudes change along a load path.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pgdl_lab.mechanics.elements import Discretisation

Array = NDArray[np.float64]
Amplitudes = Mapping[str, float]


@dataclass(frozen=True)
class Response:
    """What a term answers to a displacement, at an amplitude of 1.

    Attributes
    ----------
    energy
        The term itself [N mm per unit of its amplitude].
    forces
        Its first derivative [N per unit]: (E, 3 A) for each element, of a term without elements (N, 3).
    stiffness
        Its second derivative [N/mm per unit]: (E, 3 A, 3 A), of a term without elements sparse (3 N, 3 N); None if it
        is zero or was not asked for.
    """

    energy: float
    forces: Array
    stiffness: Any

    def __add__(self, other: "Response") -> "Response":
        both = self.stiffness is not None and other.stiffness is not None
        stiffness = self.stiffness + other.stiffness if both else None
        return Response(self.energy + other.energy, self.forces + other.forces, stiffness)


class Term(ABC):
    """One term of the potential energy.

    Attributes
    ----------
    load
        Whether it is a load, which acts only with an amplitude; other terms count once.
    nodes
        (E, A) node numbers of its elements; None: it has no elements.
    active
        Whether it counts at all for the time being.
    """

    load: ClassVar[bool] = False
    nodes: NDArray[np.int64] | None = None
    active: bool = True

    @abstractmethod
    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        """Energy, forces and, if asked for, stiffness at `displacement` (N, 3) [mm]."""

    def sideways(self, displacement: Array) -> Response:
        """The same for half a body, with the stiffness against motions that are antisymmetric about its plane."""
        return self.response(displacement, stiffness=True)

    def push(self, displacement: Array) -> Array:
        """Forces on the body at an amplitude of 1, laid out as in `Response`, also right where it is held."""
        return -self.response(displacement, stiffness=False).forces

    def free_step(self, displacement: Array, correction: Array) -> float:
        """Largest part of `correction`, at most 1, after which the energy is still finite."""
        return 1.0


class DeadLoad(Term):
    """Forces that stay as they are, whatever the body does: −f · u.

    Parameters
    ----------
    forces
        (N, 3) nodal forces at an amplitude of 1 [N].
    """

    load = True

    def __init__(self, forces: Array) -> None:
        self.forces = forces

    @classmethod
    def weight(cls, body: "Discretisation", force_n_mm3: Array) -> Self:
        """A force (3,) on each undeformed volume [N/mm³]."""
        return cls(body.nodal_volumes()[:, None] * force_n_mm3)

    @classmethod
    def traction(cls, body: "Discretisation", facets: "str | NDArray[np.int64]", traction_mpa: Array) -> Self:
        """A force (3,) on each undeformed area [MPa] of facets, by their numbers or the name of their boundary."""
        return cls(body.nodal_areas(facets)[:, None] * traction_mpa)

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        return Response(-float((self.forces * displacement).sum()), -self.forces, None)


class Schedule(Protocol):
    """Amplitudes along a leg of a load path, by its parameter."""

    def at(self, parameter: float) -> Amplitudes:
        """The amplitudes at `parameter`."""

    def rates(self, parameter: float) -> Amplitudes:
        """Their derivatives with respect to it; those that do not change may be missing."""


@dataclass(frozen=True)
class Ramp:
    """Amplitudes that rise in proportion to the parameter, beside others that are held.

    Attributes
    ----------
    rising
        What each rises by per unit of the parameter.
    held
        What stays as it is.

    Examples
    --------
    >>> inflation = Ramp({"air": 1e-3}, held={"weight": 1.0})
    >>> inflation.at(20.0)  # 20 kPa are 0.02 MPa
    {'weight': 1.0, 'air': 0.02}
    """

    rising: Amplitudes
    held: Amplitudes = field(default_factory=dict)

    def at(self, parameter: float) -> Amplitudes:
        return {**self.held, **{name: rate * parameter for name, rate in self.rising.items()}}

    def rates(self, parameter: float) -> Amplitudes:
        return self.rising
