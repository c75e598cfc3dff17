"""A planar rod of finite stretch, shear and rotation.

E. Reissner's rod (Zeitschrift für angewandte Mathematik und Physik 23, 1972) as J. C. Simo and L. Vu-Quoc discretise
it (Computer Methods in Applied Mechanics and Engineering 58, 1986): two nodes, one integration point, which is free of
shear locking. With x', z' the derivatives of the displaced axis by the undeformed length and φ the rotation of the
section, positive from x to z, the strains are

    Γ = x' cos φ + z' sin φ − 1,    H = z' cos φ − x' sin φ,    κ = φ',

so that a fibre at the height ζ above the axis is stretched by Γ − ζ κ. The volume of a cavity that moves with the
sections is linear in them: air at pressure p acts with a constant force and moment that turn with the rod.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.assembly import Assembler
from pgdl_lab.mechanics.contact import NoContact
from pgdl_lab.mechanics.equilibrium import Balance, Equilibrium, Load

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sections:
    """What the rod is made of, element by element.

    Attributes
    ----------
    stiffness
        (E, 3, 3) normal force [N], shear force [N] and moment [N mm] per Γ [–], H [–] and κ [1/mm].
    air
        (E, 3) the same per pressure of the air [mm², mm², mm³].
    mass
        (E,) [tonne].
    lever
        (E,) height of the centre of mass above the axis [mm].
    """

    stiffness: Array
    air: Array
    mass: Array
    lever: Array


class Rod(Equilibrium):
    """Potential energy of a rod along x, clamped at its left end, under weight and air pressure.

    Each node has the displacements along x and z [mm] and the rotation from x to z [rad].

    Parameters
    ----------
    nodes
        (N,) where the nodes lie on the undeformed axis, rising [mm].
    sections
        Of the N − 1 elements between them.
    gravity
        (2,) along x and z [mm/s²].
    """

    def __init__(self, nodes: Array, sections: Sections, gravity: Array) -> None:
        self.nodes, self.sections, self.gravity = nodes, sections, gravity
        self.length = np.diff(nodes)
        self.ends = np.column_stack([np.arange(len(nodes) - 1), np.arange(1, len(nodes))]).astype(np.int64)
        self.free = np.ones((len(nodes), 3), dtype=bool)
        self.free[0] = False
        self.contact, self.sideways = NoContact(), None
        self.weight = np.zeros((len(nodes), 3))
        for side in (0, 1):
            self.weight[self.ends[:, side], :2] += sections.mass[:, None] / 2 * gravity
        self._assembler = Assembler([self.ends], self.free)
        # From the six nodal values to (x' − 1, z', φ, φ').
        self._local = np.zeros((len(self.length), 4, 6))
        for row, component in ((0, 0), (1, 1), (3, 2)):
            self._local[:, row, component] = -1 / self.length
            self._local[:, row, component + 3] = 1 / self.length
        self._local[:, 2, [2, 5]] = 0.5

    def strains(self, displacement: Array) -> Array:
        """Γ [–], H [–] and κ [1/mm] of each element (E, 3) at `displacement` (N, 3)."""
        return self._kinematics(displacement)[0]

    def _kinematics(self, displacement: Array) -> tuple[Array, Array, Array]:
        """Strains (E, 3) with their first (E, 3, 4) and second (E, 3, 4, 4) derivatives by (x', z', φ, φ')."""
        local = np.einsum("eij,ej->ei", self._local, displacement[self.ends].reshape(-1, 6))
        along, up, angle, curvature = local[:, 0] + 1, local[:, 1], local[:, 2], local[:, 3]
        cos, sin = np.cos(angle), np.sin(angle)
        stretch, shear = along * cos + up * sin, up * cos - along * sin
        first = np.zeros((len(local), 3, 4))
        first[:, 0, :3] = np.column_stack([cos, sin, shear])
        first[:, 1, :3] = np.column_stack([-sin, cos, -stretch])
        first[:, 2, 3] = 1
        second = np.zeros((len(local), 3, 4, 4))
        second[:, 0, :3, 2] = second[:, 0, 2, :3] = np.column_stack([-sin, cos, -stretch])
        second[:, 1, :3, 2] = second[:, 1, 2, :3] = np.column_stack([-cos, -sin, -shear])
        return np.column_stack([stretch - 1, shear, curvature]), first, second

    def balance(self, displacement: Array, load: Load, *, stiffness: bool) -> Balance:
        strain, first, second = self._kinematics(displacement)
        law, blown = self.sections, load.pressure_mpa * self.sections.air
        elastic = np.einsum("eij,ej->ei", law.stiffness, strain)
        energy = float((self.length[:, None] * (elastic / 2 - blown) * strain).sum())
        resultants = self.length[:, None] * (elastic - blown)
        gradient = np.einsum("ei,eia->ea", resultants, first)

        # The centre of mass is carried around by the section: it lies at lever (−sin φ, cos φ) from the axis.
        angle = displacement[self.ends, 2].mean(axis=1)
        heavy = load.weight * law.mass * law.lever
        (gx, gz), cos, sin = self.gravity, np.cos(angle), np.sin(angle)
        energy += float((heavy * (gx * sin - gz * (cos - 1))).sum())
        energy -= load.weight * float((self.weight * displacement).sum())
        gradient[:, 2] += heavy * (gx * cos + gz * sin)
        forces = self._assembler.vector(np.einsum("ea,eai->ei", gradient, self._local)) - load.weight * self.weight
        if not stiffness:
            return Balance(energy, forces, None)
        hessian = np.einsum("eia,eij,ejb->eab", first, self.length[:, None, None] * law.stiffness, first, optimize=True)
        hessian += np.einsum("ei,eiab->eab", resultants, second)
        hessian[:, 2, 2] += heavy * (gz * cos - gx * sin)
        matrices = np.einsum("eai,eab,ebj->eij", self._local, hessian, self._local, optimize=True)
        return Balance(energy, forces, self._assembler.upper(matrices))

    def pressure_forces(self, displacement: Array) -> Array:
        _, first, _ = self._kinematics(displacement)
        gradient = np.einsum("ei,eia->ea", self.length[:, None] * self.sections.air, first)
        return self._assembler.vector(np.einsum("ea,eai->ei", gradient, self._local))
