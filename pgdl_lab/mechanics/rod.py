"""A planar rod of finite stretch, shear and rotation.

E. Reissner's rod (Zeitschrift für angewandte Mathematik und Physik 23, 1972) as J. C. Simo and L. Vu-Quoc discretise
it (Computer Methods in Applied Mechanics and Engineering 58, 1986): two nodes, one integration point, which is free of
shear locking. With x', z' the derivatives of the displaced axis by the undeformed length and φ the rotation of the
section, positive from x to z, the strains are

    Γ = x' cos φ + z' sin φ − 1,    H = z' cos φ − x' sin φ,    κ = φ',

so that a fibre at the height ζ above the axis is stretched by Γ − ζ κ. The volume of a cavity that moves with the
sections is linear in them: air at pressure p acts with a constant force and moment that turn with the rod.
"""

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.term import Response, Term

Array = NDArray[np.float64]


class Axis:
    """The axis of a rod along x in two-node elements.

    Each node has the displacements along x and z [mm] and the rotation from x to z [rad].

    Parameters
    ----------
    places
        (N,) where the nodes lie on the undeformed axis, rising [mm].
    """

    def __init__(self, places: Array) -> None:
        self.places, self.length = places, np.diff(places)
        self.ends = np.column_stack([np.arange(len(places) - 1), np.arange(1, len(places))]).astype(np.int64)
        # From the six nodal values to (x' − 1, z', φ, φ').
        self._local = np.zeros((len(self.length), 4, 6))
        for row, component in ((0, 0), (1, 1), (3, 2)):
            self._local[:, row, component] = -1 / self.length
            self._local[:, row, component + 3] = 1 / self.length
        self._local[:, 2, [2, 5]] = 0.5

    def strains(self, displacement: Array) -> Array:
        """Γ [–], H [–] and κ [1/mm] of each element (E, 3) at `displacement` (N, 3)."""
        return self.kinematics(displacement)[0]

    def kinematics(self, displacement: Array) -> tuple[Array, Array, Array]:
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

    def response(self, energy: float, gradient: Array, hessian: Array | None) -> Response:
        """From derivatives by (x', z', φ, φ'), (E, 4) and (E, 4, 4), to those by the nodal values."""
        matrices = None
        if hessian is not None:
            matrices = np.einsum("eai,eab,ebj->eij", self._local, hessian, self._local, optimize=True)
        return Response(energy, np.einsum("ea,eai->ei", gradient, self._local), matrices)


class Bending(Term):
    """The elastic energy of a rod, quadratic in its strains.

    Parameters
    ----------
    axis
        Its axis.
    stiffness
        (E, 3, 3) normal force [N], shear force [N] and moment [N mm] per Γ [–], H [–] and κ [1/mm].
    """

    def __init__(self, axis: Axis, stiffness: Array) -> None:
        self.axis, self.nodes, self._stiffness = axis, axis.ends, axis.length[:, None, None] * stiffness

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        strain, first, second = self.axis.kinematics(displacement)
        resultants = np.einsum("eij,ej->ei", self._stiffness, strain)
        hessian = None
        if stiffness:
            hessian = np.einsum("eia,eij,ejb->eab", first, self._stiffness, first, optimize=True)
            hessian += np.einsum("ei,eiab->eab", resultants, second)
        energy = float((resultants / 2 * strain).sum())
        return self.axis.response(energy, np.einsum("ei,eia->ea", resultants, first), hessian)


class Inflation(Term):
    """Minus the volume of cavities that move with the sections of a rod; its amplitude is their pressure [MPa].

    Parameters
    ----------
    axis
        Of the rod.
    air
        (E, 3) normal force, shear force and moment per pressure of the air [mm², mm², mm³].
    """

    load = True

    def __init__(self, axis: Axis, air: Array) -> None:
        self.axis, self.nodes, self._air = axis, axis.ends, -axis.length[:, None] * air

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        strain, first, second = self.axis.kinematics(displacement)
        hessian = np.einsum("ei,eiab->eab", self._air, second) if stiffness else None
        return self.axis.response(float((self._air * strain).sum()), np.einsum("ei,eia->ea", self._air, first), hessian)


class SectionWeight(Term):
    """The weight of the sections of a rod, whose centres of mass they carry around: at lever (−sin φ, cos φ).

    Parameters
    ----------
    axis
        Of the rod.
    mass
        (E,) [tonne].
    lever
        (E,) height of the centre of mass above the axis [mm].
    gravity
        (2,) along x and z [mm/s²].
    """

    load = True

    def __init__(self, axis: Axis, mass: Array, lever: Array, gravity: Array) -> None:
        self.axis, self.nodes, self._gravity, self._heavy = axis, axis.ends, gravity, mass * lever
        self._straight = np.zeros((len(mass), 2, 3))  # half of the weight at each end
        self._straight[:, :, :2] = mass[:, None, None] / 2 * gravity

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        angle = displacement[self.axis.ends, 2].mean(axis=1)
        (gx, gz), cos, sin = self._gravity, np.cos(angle), np.sin(angle)
        energy = float((self._heavy * (gx * sin - gz * (cos - 1))).sum())
        energy -= float((self._straight * displacement[self.axis.ends]).sum())
        gradient, hessian = np.zeros((len(angle), 4)), None
        gradient[:, 2] = self._heavy * (gx * cos + gz * sin)
        if stiffness:
            hessian = np.zeros((len(angle), 4, 4))
            hessian[:, 2, 2] = self._heavy * (gz * cos - gx * sin)
        turned = self.axis.response(energy, gradient, hessian)
        return Response(energy, turned.forces - self._straight.reshape(-1, 6), turned.stiffness)


def rod(axis: Axis, stiffness: Array, air: Array, mass: Array, lever: Array, gravity: Array) -> Equilibrium:
    """A rod clamped at its left end under weight and air pressure; for its sections and `gravity` see its terms."""
    free = np.ones((len(axis.places), 3), dtype=bool)
    free[0] = False
    terms = {
        "bending": Bending(axis, stiffness),
        "air": Inflation(axis, air),
        "weight": SectionWeight(axis, mass, lever, gravity),
    }
    return Equilibrium(terms, free)
