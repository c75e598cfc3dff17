"""A finger as a plane body: its x–z section, with a layer across the cavities for the side walls.

The elements are those of the solid without the third direction: nine nodes, discontinuous linear pressure. In solid
regions they have the width of the finger, over cavities that of both side walls, of whose stiffness only a share
counts. Taken whole, the layer would hold the walls of a chamber as if they were glued to it over their whole width, and
pressure would bend next to nothing; in truth they bulge between the side walls, which bulge in turn. No section with
one displacement for all y knows of that. With six functions of y at each point (a parabola and a quartic for the
walls, stretch and bending of the side walls) and no share the tip of pneunet is still 18 % off at 50 kPa, and that took
longer than the solid. So the share is a calibrated number.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.air import Air
from pgdl_lab.mechanics.elements import Discretisation, pressure_modes
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.lattice import Lattice
from pgdl_lab.mechanics.material import Material
from pgdl_lab.mechanics.plane_stress import PlaneStress
from pgdl_lab.mechanics.profile import Region
from pgdl_lab.mechanics.reduced import ReducedModel
from pgdl_lab.mechanics.segments import Segment, cuts, meet, segments
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.mechanics.term import DeadLoad

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlaneState:
    """What goes for all points of a section.

    Attributes
    ----------
    law
        The law in the plane, of that in three dimensions.
    side_wall_share
        Share of the side walls' stiffness that counts over the cavities [–], calibrated on `finger=pneunet`.
    """

    law: Callable[[Material], Material]
    side_wall_share: float


STATES = {"plane_strain": PlaneState(lambda law: law, 0.09), "plane_stress": PlaneState(PlaneStress, 0.4)}


def discretise_plane(mesh: "Mesh", width_mm: Array) -> Discretisation:
    """Nine-node elements on a `mesh` of quadrilaterals in x and z [mm], each of its own width (E,) along y [mm]."""
    import skfem

    basis = skfem.CellBasis(mesh, skfem.ElementQuad2(), intorder=5)
    gradients = np.stack([phi.grad for (phi,) in basis.basis]).transpose(2, 0, 1, 3)  # (E, A, 2, Q)
    weights = basis.dx * width_mm[:, None]
    return Discretisation(
        basis=basis,
        nodes=basis.element_dofs.T.astype(np.int64),
        positions=np.insert(basis.doflocs.T, 1, 0.0, axis=1),
        gradients=np.insert(gradients, 1, 0.0, axis=2),
        weights=weights,
        modes=pressure_modes(np.asarray(basis.global_coordinates()), weights, 3),
    )


def part(body: Discretisation, elements: NDArray[np.int64], factor: Array) -> Discretisation:
    """Some `elements` (F,) of a plane body, their widths multiplied by `factor` (F,)."""
    weights = body.weights[elements] * factor[:, None]
    modes = body.modes[elements] / np.sqrt(factor)[:, None, None]
    return Discretisation(body.basis, body.nodes[elements], body.positions, body.gradients[elements], weights, modes)


class PlaneFinger(ReducedModel):
    """The section of a finger.

    Parameters
    ----------
    finger
        What is modelled.
    edge_mm
        Longest element edge [mm].
    state
        Of all its points.
    """

    def __init__(self, finger: ExtrudedFinger, edge_mm: float, state: PlaneState) -> None:
        from skfem import MeshQuad

        self._edge_mm = edge_mm
        grid = finger.profile().refined(edge_mm)
        self.lattice = Lattice(grid)
        block = MeshQuad.init_tensor(grid.x, grid.z)
        mesh = block.restrict(np.flatnonzero(grid.region(*block.p[:, block.t].mean(axis=1)) != Region.GAP))
        hollow = grid.region(*mesh.p[:, mesh.t].mean(axis=1)) == Region.CAVITY
        walls_mm = 2 * finger.side_wall_mm
        whole = discretise_plane(mesh, np.where(hollow, walls_mm, finger.width_mm))
        every, cavity = np.arange(len(hollow)), np.flatnonzero(hollow)
        stiff = part(whole, every, np.where(hollow, state.side_wall_share, 1.0))
        air = part(whole, cavity, np.full(len(cavity), (finger.width_mm - walls_mm) / walls_mm))
        free = np.ones(whole.positions.shape, dtype=bool)
        free[:, 1] = False
        free[np.isclose(whole.positions[:, 0], grid.x[0])] = False
        self.mesh, self.nodes = mesh, self.lattice.nearest(*whole.positions[:, [0, 2]].T)
        weight = DeadLoad.weight(whole, finger.body_force_n_mm3)  # the side walls have all of theirs
        solid = Solid(stiff, state.law(finger.material))
        super().__init__(finger, Equilibrium({"solid": solid, "air": Air(air), "weight": weight}, free))

    def observer(self, face: Face) -> Callable[[Array, float], Array]:
        matrix = self.lattice.interpolation(face.domain.points_mm)[:, self.nodes]
        return lambda displacement, _: matrix @ displacement[:, [0, 2]]

    def touches(self, state: Array, kpa: float) -> bool:
        """By the segments of the rod, free to bend: walls that bulge between side walls are none of a section."""
        free = [np.linalg.solve(each.stiffness, each.air) for each in self._segments]
        return meet(self._segments, 1e-3 * kpa * np.insert(free, 2, 1.0, axis=1))

    @cached_property
    def _segments(self) -> list[Segment]:
        profile = self.finger.profile()
        return segments(self.finger, cuts(profile), self._edge_mm, float(profile.z[[0, -1]].mean()))

    def size(self) -> dict[str, Any]:
        return {"elements": self.mesh.nelements, "nodes": len(self.nodes)}
