"""Balance of forces on the x–z section of a finger, in weak form, for any displacement of its nodes.

Nine-node elements cover the section: solid regions with the width of the finger, cavities with that of both side walls.
The nodal forces are the derivative of the potential energy

    Π(u) = ∫ Ψ(F) t dA − p ∫ det F t_air dA − ∫ b · u t dA,

with the width t of the material and t_air of the air. By Gauss's theorem the second integral is the enclosed volume, so
its derivative is the follower pressure on the walls. Forces are measured in the norm that is dual to the shear energy,
as rᵀ G⁻¹ r with G_ab = ∫ μ t ∇N_a · ∇N_b dA (S. Rojas et al., Robust variational physics-informed neural networks,
2024): mesh and rotation leave it as it is.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pgdl_lab.core.errors import InputError
from pgdl_lab.learning.plane import PlaneLaw
from pgdl_lab.mechanics.finger import ExtrudedFinger, Finger
from pgdl_lab.mechanics.profile import Region

if TYPE_CHECKING:
    from pgdl_lab.learning.scene import Scene

Floats = NDArray[np.float64]


class SectionBalance:
    """The nodal forces of a section.

    Parameters
    ----------
    finger
        The finger; it has a profile.
    law
        Its material in the plane.
    edge_mm
        Longest element edge [mm].
    side_wall_share
        Share of the side walls' stiffness that counts over the cavities [–].
    """

    def __init__(self, finger: ExtrudedFinger, law: PlaneLaw, edge_mm: float, side_wall_share: float) -> None:
        from skfem import CellBasis, ElementQuad2, MeshQuad

        self.law = law
        grid = finger.profile().refined(edge_mm)
        block = MeshQuad.init_tensor(grid.x, grid.z)
        mesh = block.restrict(np.flatnonzero(grid.region(*block.p[:, block.t].mean(axis=1)) != Region.GAP))
        hollow = grid.region(*mesh.p[:, mesh.t].mean(axis=1)) == Region.CAVITY
        basis = CellBasis(mesh, ElementQuad2(), intorder=5)
        values = np.stack([np.broadcast_to(phi, basis.dx.shape) for (phi,) in basis.basis], axis=1)
        walls_mm = 2 * finger.side_wall_mm
        solid = np.where(hollow, walls_mm, finger.width_mm)[:, None] * basis.dx
        self.points_mm: Floats = basis.doflocs.T.copy()
        self.nodes = torch.from_numpy(basis.element_dofs.T.astype(np.int64))
        self.gradients = torch.from_numpy(np.stack([phi.grad for (phi,) in basis.basis]).transpose(2, 0, 3, 1))
        self.stiff = torch.from_numpy(np.where(hollow, side_wall_share, 1.0)[:, None] * solid)  # (E, Q) [mm³]
        self.air = torch.from_numpy(np.where(hollow, finger.width_mm - walls_mm, 0.0)[:, None] * basis.dx)
        volumes = np.zeros(len(self.points_mm))
        np.add.at(volumes, basis.element_dofs.T, (values * solid[:, None]).sum(axis=2))
        self.weight = torch.from_numpy(volumes[:, None] * finger.body_force_n_mm3[::2])  # (N, 2) [N]
        self.free = torch.from_numpy(np.flatnonzero(~np.isclose(self.points_mm[:, 0], grid.x[0])))
        self._cast: dict[tuple[torch.dtype, torch.device], dict[str, Tensor]] = {}

    @cached_property
    def stiffness_n(self) -> float:
        """μ times the volume of the stiff material, by which rᵀ G⁻¹ r becomes the mean square of a strain [N mm]."""
        return self.law.material.shear_modulus_mpa * float(self.stiff.sum())

    @cached_property
    def inverse_gram(self) -> Tensor:
        """(M, M), G⁻¹ over the M free nodes [mm/N]."""
        local = self.law.material.shear_modulus_mpa * torch.einsum(
            "eq,eaqi,ebqi->eab", self.stiff, self.gradients, self.gradients
        )
        count = self.nodes.shape[1]
        rows, columns = self.nodes.repeat_interleave(count, dim=1).ravel(), self.nodes.repeat(1, count).ravel()
        whole = torch.zeros((len(self.points_mm),) * 2, dtype=torch.double)
        whole.index_put_((rows, columns), local.ravel(), accumulate=True)
        return torch.cholesky_inverse(torch.linalg.cholesky(whole[self.free][:, self.free]))

    def forces(self, displacement: Tensor, pressure_mpa: Tensor) -> Tensor:
        """Nodal forces (N, 2) [N] that are out of balance, zero at an equilibrium but for the clamped nodes.

        Parameters
        ----------
        displacement
            (N, 2) at `points_mm` [mm].
        pressure_mpa
            (), air pressure [MPa].
        """
        at = self._tensors(displacement)
        nodal = displacement[at["nodes"]]  # (E, A, 2)
        gradient = torch.einsum("eai,eaqj->eqij", nodal, at["gradients"])
        stress = at["stiff"][..., None, None] * self.law.stress(gradient)
        (xx, xz), (zx, zz) = (row.unbind(-1) for row in gradient.unbind(-2))
        cofactor = torch.stack([1 + zz, -zx, -xz, 1 + xx], dim=-1).reshape(gradient.shape)
        stress = stress - pressure_mpa * at["air"][..., None, None] * cofactor
        local = torch.einsum("eqij,eaqj->eai", stress, at["gradients"])
        inner = torch.zeros_like(displacement).index_add(0, at["nodes"].ravel(), local.flatten(0, 1))
        return inner - at["weight"]

    def mean_square_strain(self, forces: Tensor) -> Tensor:
        """rᵀ G⁻¹ r / (μ V) () [–]: the mean square of the strain that balances `forces` (N, 2) [N]."""
        at = self._tensors(forces)
        free = forces[at["free"]]
        return (free * (at["inverse_gram"] @ free)).sum() / self.stiffness_n

    def _tensors(self, like: Tensor) -> dict[str, Tensor]:
        """The fixed tensors in the type and on the device of `like`."""
        key = like.dtype, like.device
        if key not in self._cast:
            real = {name: getattr(self, name) for name in ("gradients", "stiff", "air", "weight", "inverse_gram")}
            whole = {"nodes": self.nodes, "free": self.free}
            self._cast[key] = {name: tensor.to(like) for name, tensor in real.items()} | {
                name: tensor.to(like.device) for name, tensor in whole.items()
            }
        return self._cast[key]


def suited(finger: Finger | None, state: str) -> tuple[ExtrudedFinger, PlaneLaw]:
    """The finger and its law in the plane.

    Raises
    ------
    InputError
        When there is no finger, it has no profile or its law is none of the first invariant.
    """
    if not isinstance(finger, ExtrudedFinger):
        found = "none is known" if finger is None else f"{type(finger).__name__} has none"
        raise InputError(f"Loss section needs a finger with a profile, but {found}; leave it out.")
    return finger, PlaneLaw.of(finger.material, state, "section")


@lru_cache(maxsize=4)
def section_balance(scene: Scene, state: str, edge_mm: float, side_wall_share: float) -> SectionBalance:
    """The section of the finger of a scene; raises as `suited` does."""
    finger, law = suited(scene.finger, state)
    return SectionBalance(finger, law, edge_mm, side_wall_share)
