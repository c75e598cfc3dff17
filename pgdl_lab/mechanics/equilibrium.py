"""The equilibrium of a finger: inner forces against weight and air pressure."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.assembly import Assembler
from pgdl_lab.mechanics.cavity import Cavity, CavityResponse
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.elements import Discretisation
from pgdl_lab.mechanics.solid import Response, Solid
from pgdl_lab.mechanics.surface import ContactResponse

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Load:
    """What acts on the finger: a fraction of its weight [–] and the air pressure [MPa]."""

    weight: float
    pressure_mpa: float


@dataclass(frozen=True)
class Balance:
    """Potential energy of a displaced finger and its derivatives.

    Attributes
    ----------
    energy
        Elastic energy less the work of weight and air [N mm].
    forces
        (N, 3) gradient: inner less outer nodal forces, at held degrees of freedom the reaction of the support [N].
    stiffness
        Upper triangle of the Hessian at the free degrees of freedom [N/mm]; None if not asked for.
    """

    energy: float
    forces: Array
    stiffness: "csr_matrix | None"


class Equilibrium:
    """The potential energy of solid, weight and air, whose stationary points are the equilibria.

    Parameters
    ----------
    solid, cavity
        The body and the walls under pressure.
    body_force_n_mm3
        (3,) weight per undeformed volume [N/mm³].
    free
        (N, 3) bool, which displacement components are not held fixed.
    contact
        Keeps surfaces apart while it is active.
    sideways
        (N, 3) bool, which components are free in motions that are antisymmetric about the plane of symmetry; None where
        nothing is left out by symmetry.
    """

    def __init__(
        self,
        solid: Solid,
        cavity: Cavity,
        body_force_n_mm3: Array,
        free: NDArray[np.bool_],
        contact: Contact,
        sideways: NDArray[np.bool_] | None = None,
    ) -> None:
        self.solid, self.cavity, self.free, self.contact, self.sideways = solid, cavity, free, contact, sideways
        self.weight = nodal_volumes(solid.discretisation)[:, None] * body_force_n_mm3
        self._assembler = self._assembler_of(free)

    def _assembler_of(self, free: NDArray[np.bool_]) -> Assembler:
        return Assembler([self.solid.discretisation.nodes, self.cavity.nodes], free)

    @cached_property
    def _sideways_assembler(self) -> Assembler:
        assert self.sideways is not None
        return self._assembler_of(self.sideways)

    def balance(self, displacement: Array, load: Load, *, stiffness: bool) -> Balance:
        """Energy, forces and, if asked for, stiffness at `displacement` (N, 3) [mm] under `load`.

        Raises
        ------
        InvertedElement
            When an element is turned inside out.
        """
        return self._balance(self.solid.response(displacement, stiffness=stiffness), displacement, load, stiffness)

    def balance_at(self, pressure: Array, displacement: Array, load: Load) -> Balance:
        """As `balance`, with stiffness, but at a given pressure (E, Q) [MPa] in the solid, see `Solid.response`."""
        return self._balance(
            self.solid.response(displacement, stiffness=True, pressure=pressure), displacement, load, True
        )

    def _balance(self, inner: Response, displacement: Array, load: Load, stiffness: bool) -> Balance:
        air = self.cavity.response(displacement, hessian=stiffness)
        p = load.pressure_mpa
        energy = inner.energy - p * air.volume - load.weight * float((self.weight * displacement).sum())
        forces = self._assembler.vector(inner.forces, -p * air.gradient) - load.weight * self.weight
        touch = self.contact.response(displacement, hessian=stiffness) if self.contact.active else None
        if touch is not None:
            energy, forces = energy + touch.energy, forces + touch.forces
        return Balance(energy, forces, _hessian(self._assembler, inner, air, p, touch) if stiffness else None)

    def sideways_stiffness(self, displacement: Array, load: Load) -> "csr_matrix":
        """Upper triangle of the Hessian over the `sideways` degrees of freedom at `displacement` (N, 3) [mm].

        Of the whole body, half the second derivative of the energy by motions that are antisymmetric about y = 0: each
        half has the same share of it. Its negative eigenvalues are instabilities that break the symmetry.
        """
        return _hessian(
            self._sideways_assembler,
            self.solid.response(displacement, stiffness=True),
            self.cavity.response(displacement, hessian=True),
            load.pressure_mpa,
            self.contact.response(displacement, hessian=True, mirror=False) if self.contact.active else None,
        )

    def free_step(self, displacement: Array, correction: Array) -> float:
        """Largest part of `correction`, at most 1, that brings no surfaces together."""
        return self.contact.free_step(displacement, correction) if self.contact.active else 1.0

    def pressure_forces(self, displacement: Array) -> Array:
        """Nodal forces (N, 3) of a unit of pressure [N/MPa] at `displacement` (N, 3) [mm], right where it is free."""
        air = self.cavity.response(displacement, hessian=False)
        return self._assembler.vector(None, air.gradient)

    def reaction_and_load(self, displacement: Array, load: Load) -> tuple[Array, Array]:
        """Reaction of the support, and sum of weight and air: (3,) each [N]; they cancel in equilibrium.

        Where a cavity ends at the support, what closes it does not push on the body: the air alone, on the walls, does.
        """
        pushed = load.pressure_mpa * self._assembler.vector(None, self.cavity.push(displacement))
        inner = self.balance(displacement, Load(0.0, 0.0), stiffness=False).forces
        outer = load.weight * self.weight + pushed
        return ((inner - outer) * ~self.free).sum(axis=0), outer.sum(axis=0)


def _hessian(
    assembler: Assembler, inner: Response, air: CavityResponse, pressure_mpa: float, touch: ContactResponse | None
) -> "csr_matrix":
    assert inner.stiffness is not None and air.hessian is not None
    upper = assembler.upper(inner.stiffness, -pressure_mpa * air.hessian)
    if touch is not None and touch.stiffness is not None and touch.stiffness.nnz:
        upper = assembler.with_upper(upper, touch.stiffness)
    return upper


def nodal_volumes(mesh: Discretisation) -> Array:
    """Integral of each shape function over the undeformed body (N,) [mm³]."""
    value = np.stack([np.broadcast_to(phi, mesh.weights.shape) for (phi,) in mesh.basis.basis], axis=1)
    volumes = np.einsum("eaq,eq->ea", value, mesh.weights)
    return np.bincount(mesh.nodes.ravel(), volumes.ravel(), len(mesh.positions)).astype(np.float64)
