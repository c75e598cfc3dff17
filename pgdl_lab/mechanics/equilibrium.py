"""The potential energy of a body as a sum of named terms, whose stationary points are the equilibria."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.assembly import Assembler
from pgdl_lab.mechanics.cavity import Chamber
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.mechanics.term import Amplitudes, Response, Term

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Balance:
    """Potential energy of a displaced body and its derivatives.

    Attributes
    ----------
    energy
        Stored energy less the work of the loads [N mm].
    forces
        (N, 3) gradient: inner less outer nodal forces, at held degrees of freedom the reaction of the support [N].
    stiffness
        Upper triangle of the Hessian at the free degrees of freedom [N/mm]; None if not asked for.
    """

    energy: float
    forces: Array
    stiffness: "csr_matrix | None"


class Equilibrium:
    """What balances in a body.

    Amplitudes, wherever they are asked for, say how much of each load acts: by name, of dead loads as a part of what
    they are [–], of the air its pressure [MPa]. A load that is not named does not act.

    Parameters
    ----------
    terms
        Of the potential energy, by name; "solid" and "contact" are what the attributes of these names are.
    free
        (N, 3) bool, which displacement components are not held fixed.
    sideways
        (N, 3) bool, which components are free in motions that are antisymmetric about the plane of symmetry; None where
        nothing is left out by symmetry.
    """

    def __init__(
        self, terms: Mapping[str, Term], free: NDArray[np.bool_], sideways: NDArray[np.bool_] | None = None
    ) -> None:
        self.terms, self.free, self.sideways = dict(terms), free, sideways

    @property
    def solid(self) -> Solid:
        """The term "solid"; there is none in a rod."""
        solid = self.terms["solid"]
        assert isinstance(solid, Solid)
        return solid

    @property
    def contact(self) -> Contact | None:
        """The term "contact", if there is one."""
        contact = self.terms.get("contact")
        assert contact is None or isinstance(contact, Contact)
        return contact

    def with_terms(self, **terms: Term) -> "Equilibrium":
        """The same body with more terms, or others under the same names."""
        result = Equilibrium({**self.terms, **terms}, self.free, self.sideways)
        if [*map(id, result._groups.values())] == [*map(id, self._groups.values())]:
            result._assembler = self._assembler  # its pattern takes long on a fine mesh
        return result

    @cached_property
    def _groups(self) -> dict[str, NDArray[np.int64]]:
        return {name: term.nodes for name, term in self.terms.items() if term.nodes is not None}

    @cached_property
    def _assembler(self) -> Assembler:
        return Assembler([*self._groups.values()], self.free)

    @cached_property
    def _sideways_assembler(self) -> Assembler:
        assert self.sideways is not None
        return Assembler([*self._groups.values()], self.sideways)

    def _acting(self, amplitudes: Amplitudes) -> dict[str, float]:
        """Amplitudes of all terms that count."""
        if unknown := amplitudes.keys() - self.terms.keys():
            named, loads = ", ".join(sorted(unknown)), [name for name, term in self.terms.items() if term.load]
            raise InputError(f"No load is named {named}: there are {', '.join(loads)}.")
        given = {name: amplitudes.get(name, 0.0 if term.load else 1.0) for name, term in self.terms.items()}
        return {name: amplitude for name, amplitude in given.items() if amplitude and self.terms[name].active}

    def balance(self, displacement: Array, amplitudes: Amplitudes, *, stiffness: bool) -> Balance:
        """Energy, forces and, if asked for, stiffness at `displacement` (N, 3) [mm] under loads of these `amplitudes`.

        Raises
        ------
        InvertedElement
            When an element is turned inside out.
        """
        acting = self._acting(amplitudes)
        found = {name: self.terms[name].response(displacement, stiffness=stiffness) for name in acting}
        return Balance(
            sum(amplitude * found[name].energy for name, amplitude in acting.items()),
            self._vector({name: amplitude * found[name].forces for name, amplitude in acting.items()}),
            self._upper(self._assembler, acting, found) if stiffness else None,
        )

    def stiffness_times(self, displacement: Array, amplitudes: Amplitudes, vector: Array) -> Array:
        """The Hessian over all degrees of freedom, held ones too, times `vector` (N, 3); (N, 3) [N/mm times its unit].

        Element by element: no matrix of the whole is put together.
        """
        products = {}
        for name, amplitude in self._acting(amplitudes).items():
            term = self.terms[name]
            matrices = term.response(displacement, stiffness=True).stiffness
            if matrices is None:
                continue
            if term.nodes is None:
                products[name] = amplitude * (matrices @ vector.ravel()).reshape(vector.shape)
            else:
                local = vector[term.nodes].reshape(len(term.nodes), -1, 1)
                products[name] = amplitude * (matrices @ local)[..., 0]
        return self._vector(products)

    def sideways_stiffness(self, displacement: Array, amplitudes: Amplitudes) -> "csr_matrix":
        """Upper triangle of the Hessian over the `sideways` degrees of freedom at `displacement` (N, 3) [mm].

        Of the whole body, half the second derivative of the energy by motions that are antisymmetric about y = 0: each
        half has the same share of it. Its negative eigenvalues are instabilities that break the symmetry.
        """
        acting = self._acting(amplitudes)
        found = {name: self.terms[name].sideways(displacement) for name in acting}
        return self._upper(self._sideways_assembler, acting, found)

    def _vector(self, forces: Mapping[str, Array]) -> Array:
        """Sum (N, 3) of what each term has at its nodes."""
        total = self._assembler.vector(*(forces.get(name) for name in self._groups))
        for name, nodal in forces.items():
            if name not in self._groups:
                total = total + nodal
        return total

    def _upper(self, assembler: Assembler, acting: Mapping[str, float], found: Mapping[str, Response]) -> "csr_matrix":
        def scaled(name: str) -> Array | None:
            matrices = found[name].stiffness if name in found else None
            if matrices is None or acting[name] == 1:  # those of the solid are large, and not to be copied
                return matrices
            return acting[name] * matrices

        upper = assembler.upper(*(scaled(name) for name in self._groups))
        for name, amplitude in acting.items():
            sparse = found[name].stiffness
            if name not in self._groups and sparse is not None and sparse.nnz:
                upper = assembler.with_upper(upper, amplitude * sparse)
        return upper

    def free_step(self, displacement: Array, correction: Array) -> float:
        """Largest part of `correction`, at most 1, that brings no surfaces together."""
        return min(term.free_step(displacement, correction) for term in self.terms.values() if term.active)

    def drive(self, displacement: Array, amplitudes: Amplitudes) -> Array:
        """Nodal forces (N, 3) [N] of loads of these `amplitudes` at `displacement` (N, 3) [mm], right where it is free.

        They are what the loads change the balance by. At held degrees of freedom see `reaction_and_load`.
        """
        terms = {name: self.terms[name] for name in self._loads(amplitudes)}
        return self._sum(
            amplitudes, {name: -term.response(displacement, stiffness=False).forces for name, term in terms.items()}
        )

    def reaction_and_load(self, displacement: Array, amplitudes: Amplitudes) -> tuple[Array, Array]:
        """Reaction of the support, and sum of the loads: (3,) each [N]; they cancel in equilibrium.

        Where a cavity ends at the support, what closes it does not push on the body: the air alone, on the walls, does.
        """
        pushes = {name: self.terms[name].push(displacement) for name in self._loads(amplitudes)}
        inner, outer = self.balance(displacement, {}, stiffness=False).forces, self._sum(amplitudes, pushes)
        return ((inner - outer) * ~self.free).sum(axis=0), outer.sum(axis=0)

    def _loads(self, amplitudes: Amplitudes) -> list[str]:
        """Names of the loads that act."""
        return [name for name in self._acting(amplitudes) if self.terms[name].load]

    def _sum(self, amplitudes: Amplitudes, forces: Mapping[str, Array]) -> Array:
        """Sum (N, 3) of what each term has at its nodes, times its amplitude."""
        total = np.zeros(self.free.shape)
        for name, each in forces.items():
            total += amplitudes[name] * self._vector({name: each})
        return total

    def volumes_mm3(self, displacement: Array) -> dict[str, float]:
        """Enclosed volume of each chamber [mm³] at `displacement` (N, 3) [mm]; of half a body that of the half."""
        chambers = {name: term for name, term in self.terms.items() if isinstance(term, Chamber)}
        return {name: chamber.volume_mm3(displacement) for name, chamber in chambers.items()}
