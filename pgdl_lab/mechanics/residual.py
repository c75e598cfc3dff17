"""What is out of balance in a displaced body, as something to be made small: the forces, their derivative, their size.

At an equilibrium the forces are zero, to the tolerance that it was solved to. Their size is that of the work they would
do if they moved the body at rest, rᵀ K₀⁻¹ r with the stiffness K₀ there: mesh and units leave it as it is, and where
displacements are small it is the square of the energy norm of the error.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.linear import SymmetricSolver, symmetric_solver
from pgdl_lab.mechanics.term import Amplitudes

Array = NDArray[np.float64]


class Residual:
    """The forces that are out of balance in a body.

    For a function of them, backward goes as follows: what it changes by per force, v (N, 3), becomes what it changes by
    per displacement, `backward(displacement, amplitudes, v)`. Of `size` that v is twice `compliance(forces)`.

    Parameters
    ----------
    equilibrium
        What balances. Contact that acts in it has no finite energy where surfaces cross: a displacement that is guessed
        is better judged without it.
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        self.equilibrium = equilibrium

    def forces(self, displacement: Array, amplitudes: Amplitudes) -> Array:
        """Nodal forces (N, 3) [N] that are out of balance, zero where the support bears them.

        Parameters
        ----------
        displacement
            (N, 3) of all nodes [mm].
        amplitudes
            Of the loads, see `Equilibrium`.

        Raises
        ------
        InvertedElement
            When an element is turned inside out.
        """
        equilibrium = self.equilibrium
        return equilibrium.balance(displacement, amplitudes, stiffness=False).forces * equilibrium.free

    def backward(self, displacement: Array, amplitudes: Amplitudes, vector: Array) -> Array:
        """The derivative (N, 3) of Σ v · `forces` by the displacements, K v, for a `vector` v (N, 3); raises likewise.

        [N/mm times the unit of v]; also by displacements that are held, which a guess may have.
        """
        return self.equilibrium.stiffness_times(displacement, amplitudes, vector * self.equilibrium.free)

    def compliance(self, forces: Array) -> Array:
        """How `forces` (N, 3) [N] would move the body from rest, K₀⁻¹ r (N, 3) [mm], while that is little."""
        free = self.equilibrium.free
        moved = np.zeros(free.shape)
        moved[free] = self._at_rest.solve(forces[free])
        return moved

    def size(self, forces: Array) -> float:
        """rᵀ K₀⁻¹ r [N mm] of `forces` (N, 3) [N]."""
        return float((forces * self.compliance(forces)).sum())

    @cached_property
    def _at_rest(self) -> SymmetricSolver:
        solver = symmetric_solver()
        rest = np.zeros(self.equilibrium.free.shape)
        solver.factorise(self.equilibrium.balance(rest, {}, stiffness=True).stiffness)
        return solver
