"""Loss `navier_cauchy`: the residual of linear elastic equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.learning.loss import PhysicsLoss

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene
    from pgdl_lab.mechanics.finger import Finger

FORMS = ("published", "corrected")


@register("loss", "navier_cauchy")
@dataclass(frozen=True)
class NavierCauchyLoss(PhysicsLoss):
    """Mean over the training points of f² + g², the residuals of the Navier–Cauchy equation (paper, eq. 13).

    Lengths are in mm and moduli in MPa, so that every term of the corrected form is a force per volume [N/mm³]. The
    published form loses a derivative on the way from eq. (7) to eqs. (8) and (10): its first term is a stress [MPa]
    that is added to forces per volume, so its value depends on the unit of length. It is evaluated in MPa and mm.

    Rubber under finite strain does not obey this linear law, so its minimum does not lie at the simulated displacement,
    which has 0.079 (N/mm³)² on pneunet, but at rest, 1.2e-10 (mean over all pressures; `residuals` of each run). At the
    default weight it leaves the error of the default model as it is; the paper's weight is 1.

    Attributes
    ----------
    form
        "published": f = (λ + μ) ∂(u_x + u_z)/∂x + μ ∇²u_x + f_x, g likewise with z (eq. 10, letter by letter);
        "corrected": (λ + μ) ∇(∇·u) + μ ∇²u + F (eq. 7 in two dimensions).
    lame_mpa, shear_modulus_mpa
        Lamé's constants λ and μ [MPa]; null takes those of the finger's material at small strain.
    """

    order: ClassVar[int] = 2
    unit: ClassVar[str] = "(N/mm³)²"

    weight: float = 1e-4
    form: str = "corrected"
    lame_mpa: float | None = None
    shear_modulus_mpa: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form not in FORMS:
            raise InputError(f"loss.navier_cauchy.form is '{self.form}'; choose one of {', '.join(FORMS)}.")
        for name in ("lame_mpa", "shear_modulus_mpa"):
            modulus = getattr(self, name)
            if modulus is not None and not modulus > 0:
                raise InputError(
                    f"loss.navier_cauchy.{name} is {modulus} MPa; it must be positive, or null for the finger's."
                )

    def check(self, finger: Finger | None) -> None:
        self.refuse_sideways_gravity(finger)

    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        residual_x, residual_z = self.residuals(jet, scene)
        return (residual_x.square() + residual_z.square()).mean()

    def residuals(self, jet: Jet, scene: Scene) -> tuple[Tensor, Tensor]:
        """The residuals f and g at n points, each (n,)."""
        lame = scene.lame_mpa if self.lame_mpa is None else self.lame_mpa
        shear = scene.shear_modulus_mpa if self.shear_modulus_mpa is None else self.shear_modulus_mpa
        force_x, force_z = scene.body_force_n_mm3
        (ux_xx, ux_zz, ux_xz), (uz_xx, uz_zz, uz_xz) = (jet.hessian[:, i].unbind(dim=1) for i in range(2))
        if self.form == "published":
            volumetric_x, volumetric_z = jet.gradient.sum(dim=1).unbind(dim=1)
        else:
            volumetric_x, volumetric_z = ux_xx + uz_xz, ux_xz + uz_zz
        return (
            (lame + shear) * volumetric_x + shear * (ux_xx + ux_zz) + force_x,
            (lame + shear) * volumetric_z + shear * (uz_xx + uz_zz) + force_z,
        )
