"""Hyperelastic laws in the plane of the face: first Piola–Kirchhoff stress and its divergence.

In the plane the energy of a law of the first invariant is a function Ψ(A, d) of A = tr FᵀF and d = det F, both of the
2 × 2 deformation gradient, so that

    P = ∂Ψ/∂F = 2 Ψ_A F + Ψ_d cof F,    Div P = 2 Ψ_A ∇²u + 2 F ∇Ψ_A + cof F ∇Ψ_d,

since Div cof F = 0 (Piola's identity) and the divergence of F is ∇²u. In plane strain the stretch l out of the plane is
1; in plane stress it makes ∂W/∂l = 0, and derivatives of Ψ follow by the implicit function theorem:
Ψ_ij = W_ij − W_il W_jl / W_ll. W is that of `pgdl_lab.mechanics.material`, with J = d l.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.material import FirstInvariantMaterial, Material

LEAST_AREA = 0.2  # d below which a field counts as d = 0.2: the law says nothing of matter that is turned inside out
NEWTON = 12  # steps at most for the stretch out of the plane; convergence is quadratic from the incompressible one
CONVERGED = 1e-2  # change, by the root of the rounding error, after which another step would change nothing


def scalars(gradient: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """F (…, 2, 2), its cofactor (…, 2, 2), A and d (…), of a displacement gradient (…, 2, 2)."""
    f = gradient + torch.eye(2, dtype=gradient.dtype, device=gradient.device)
    xx, xz, zx, zz = f.flatten(-2).unbind(dim=-1)
    cofactor = torch.stack([torch.stack([zz, -zx], dim=-1), torch.stack([-xz, xx], dim=-1)], dim=-2)
    return f, cofactor, xx * xx + xz * xz + zx * zx + zz * zz, xx * zz - xz * zx


@dataclass(frozen=True)
class PlaneLaw:
    """A hyperelastic law in plane stress or plane strain.

    Attributes
    ----------
    material
        The law.
    state
        "plane_stress" or "plane_strain".
    """

    material: FirstInvariantMaterial
    state: str

    @classmethod
    def of(cls, material: Material | None, state: str, loss: str) -> PlaneLaw:
        """The law of a finger, for the loss named `loss`.

        Raises
        ------
        InputError
            When there is no finger or its law is none of the first invariant alone.
        """
        if not isinstance(material, FirstInvariantMaterial):
            found = "no material is known" if material is None else f"this material is {type(material).__name__}"
            raise InputError(
                f"Loss {loss} is written for laws of the first invariant such as finger/material=yeoh, but {found}; "
                "leave it out or choose loss=[data,navier_cauchy]."
            )
        return cls(material, state)

    def derivatives(self, a: Tensor, d: Tensor) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]:
        """Ψ_A and Ψ_d, and Ψ_AA, Ψ_Ad and Ψ_dd [MPa] at A and d (…)."""
        d = d.clamp(min=LEAST_AREA)
        slopes, (aa, ad, dd, al, dl, ll) = self._derivatives(a, d, self._stretch(a, d))
        if self.state == "plane_stress":
            aa, ad, dd = aa - al * al / ll, ad - al * dl / ll, dd - dl * dl / ll
        return (slopes[0], slopes[1]), (aa, ad, dd)

    def stress(self, gradient: Tensor) -> Tensor:
        """First Piola–Kirchhoff stress P (…, 2, 2) [MPa] of a displacement gradient (…, 2, 2)."""
        f, cofactor, a, d = scalars(gradient)
        (by_a, by_d), _ = self.derivatives(a, d)
        return 2 * by_a[..., None, None] * f + by_d[..., None, None] * cofactor

    def divergence(self, gradient: Tensor, hessian: Tensor) -> Tensor:
        """Div P (n, 2) [N/mm³] of ∇u (n, 2, 2) and second derivatives (n, 2, 3) in the order xx, zz, xz [1/mm]."""
        f, cofactor, a, d = scalars(gradient)
        (by_a, _), (aa, ad, dd) = self.derivatives(a, d)
        xx, zz, xz = hessian.unbind(dim=-1)
        along = torch.stack([torch.stack([xx, xz], dim=-1), torch.stack([xz, zz], dim=-1)], dim=-1)  # ∂F_iJ/∂X_K
        grad_a = 2 * (f[..., None] * along).sum(dim=(-3, -2))
        grad_d = (cofactor[..., None] * along).sum(dim=(-3, -2))
        grad_by_a = aa[..., None] * grad_a + ad[..., None] * grad_d
        grad_by_d = ad[..., None] * grad_a + dd[..., None] * grad_d
        return (
            2 * by_a[..., None] * (xx + zz)
            + 2 * (f * grad_by_a[..., None, :]).sum(dim=-1)
            + (cofactor * grad_by_d[..., None, :]).sum(dim=-1)
        )

    def _stretch(self, a: Tensor, d: Tensor) -> Tensor:
        """The stretch l out of the plane."""
        if self.state == "plane_strain":
            return torch.ones_like(a)
        with torch.no_grad():
            stretch = 1 / d
            for _ in range(NEWTON):
                slopes, curvatures = self._derivatives(a, d, stretch)
                before = stretch
                # halved at most, so that it stays positive
                stretch = torch.maximum(before - slopes[2] / curvatures[5], before / 2)
                if (stretch - before).abs().max() <= CONVERGED * torch.finfo(stretch.dtype).eps ** 0.5:
                    break
        if not (a.requires_grad or d.requires_grad):
            return stretch
        # one step more, with gradients: it gives l the derivatives by A and d that the implicit function theorem asks
        slopes, curvatures = self._derivatives(a, d, stretch)
        return stretch - slopes[2] / curvatures[5].detach()

    def _derivatives(self, a: Tensor, d: Tensor, stretch: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """W_A, W_d, W_l and W_AA, W_Ad, W_dd, W_Al, W_dl, W_ll [MPa] at A, d and l (…)."""
        bulk, volume = self.material.bulk_modulus_mpa, d * stretch
        shrink = volume ** (-2 / 3)
        invariant = shrink * (a + stretch * stretch)
        derivatives: Any = self.material.derivatives  # nothing but arithmetic, so tensors will do
        w1, w2 = derivatives(invariant)
        i_a, i_d = shrink, -2 / 3 * invariant / d
        i_l = 2 * shrink * stretch - 2 / 3 * invariant / stretch
        i_dd, i_ad = 10 / 9 * invariant / d**2, -2 / 3 * shrink / d
        i_al, i_dl = -2 / 3 * shrink / stretch, -2 / 3 * i_l / d
        i_ll = 2 / 3 * (shrink - i_l / stretch + invariant / stretch**2)
        pressure = bulk * (volume - 1)
        slopes = w1 * i_a, w1 * i_d + pressure * stretch, w1 * i_l + pressure * d
        curvatures = (
            w2 * i_a * i_a,
            w2 * i_a * i_d + w1 * i_ad,
            w2 * i_d * i_d + w1 * i_dd + bulk * stretch**2,
            w2 * i_a * i_l + w1 * i_al,
            w2 * i_d * i_l + w1 * i_dl + pressure + bulk * volume,
            w2 * i_l * i_l + w1 * i_ll + bulk * d**2,
        )
        return slopes, curvatures
