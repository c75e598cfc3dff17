"""The plane laws against the energy of the solid, differentiated automatically."""

import pytest
import torch
from torch import Tensor

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.plane import PlaneLaw, scalars
from pgdl_lab.learning.plane_loss import STATES
from pgdl_lab.mechanics.material import FirstInvariantMaterial, Yeoh

discover()
LAW = Yeoh(c3_mpa=0.003)


def random_gradients() -> Tensor:
    torch.manual_seed(0)
    gradient = 0.2 * torch.randn(40, 2, 2, dtype=torch.double)
    return gradient[scalars(gradient)[3] > 0.4]


def energy(material: FirstInvariantMaterial, gradient: Tensor, stretch: Tensor) -> Tensor:
    """W of F with the `stretch` out of the plane."""
    f, _, _, _ = scalars(gradient)
    whole = torch.block_diag(*[torch.zeros(1, 1, dtype=f.dtype)] * 3).expand(len(f), 3, 3).clone()
    whole[:, :2, :2], whole[:, 2, 2] = f, stretch
    volume = torch.linalg.det(whole)
    invariant = volume ** (-2 / 3) * whole.square().sum(dim=(1, 2))
    deviatoric: Tensor = material.energy(invariant)
    return deviatoric + material.bulk_modulus_mpa / 2 * (volume - 1) ** 2


@pytest.mark.parametrize("state", STATES)
def test_stress_is_the_derivative_of_the_energy(state: str) -> None:
    law, gradient = PlaneLaw(LAW, state), random_gradients().requires_grad_()
    _, _, a, d = scalars(gradient)
    stretch = law._stretch(a, d).detach().requires_grad_()
    stress, across = torch.autograd.grad(energy(LAW, gradient, stretch).sum(), (gradient, stretch))
    assert torch.allclose(law.stress(gradient), stress, rtol=1e-10, atol=1e-10)
    if state == "plane_stress":
        assert across.abs().max() < 1e-12
    else:
        assert (stretch == 1).all()


@pytest.mark.parametrize("state", STATES)
def test_divergence_of_a_curved_field(state: str) -> None:
    law = PlaneLaw(LAW, state)
    torch.manual_seed(1)
    place = torch.rand(20, 2, dtype=torch.double).requires_grad_()
    x, z = place.T
    u = [0.2 * torch.sin(2 * x + z), 0.3 * torch.cos(1.5 * z) * x]

    def grad(value: Tensor) -> Tensor:
        return torch.autograd.grad(value.sum(), place, create_graph=True)[0]

    first = torch.stack([grad(part) for part in u], dim=1)
    by_x, by_z = ([grad(first[:, i, j]) for i in range(2)] for j in range(2))
    second = torch.stack([torch.stack([p[:, 0], q[:, 1], p[:, 1]], 1) for p, q in zip(by_x, by_z, strict=True)], dim=1)
    stress = law.stress(first)
    expected = torch.stack([grad(stress[:, i, 0])[:, 0] + grad(stress[:, i, 1])[:, 1] for i in range(2)], dim=1)
    assert torch.allclose(law.divergence(first, second), expected, rtol=1e-9, atol=1e-9)


def test_plane_stress_at_small_strain_has_youngs_modulus() -> None:
    """Uniaxial stretch ε without lateral stress: P_xx = E ε, u_z,z = −ν ε."""
    law, strain = PlaneLaw(LAW, "plane_stress"), 1e-5
    gradient = torch.tensor([[[strain, 0.0], [0.0, -LAW.poisson * strain]]], dtype=torch.double)
    stress = law.stress(gradient)[0]
    assert float(stress[0, 0]) == pytest.approx(2 * LAW.shear_modulus_mpa * (1 + LAW.poisson) * strain, rel=1e-3)
    assert abs(float(stress[1, 1])) < 1e-3 * float(stress[0, 0])


@pytest.mark.parametrize("state", STATES)
def test_gradients_reach_the_field_also_where_it_is_inside_out(state: str) -> None:
    gradient = torch.tensor([[[-1.5, 0.1], [0.0, 0.2]], [[0.1, 0.0], [0.2, -0.1]]], dtype=torch.double).requires_grad_()
    hessian = torch.ones(2, 2, 3, dtype=torch.double)
    PlaneLaw(LAW, state).divergence(gradient, hessian).square().sum().backward()
    assert gradient.grad is not None and torch.isfinite(gradient.grad).all() and gradient.grad.abs().min() > 0


def test_laws_of_more_invariants_are_refused_in_one_sentence() -> None:
    with pytest.raises(
        InputError, match="Loss yeoh is written for laws of the first invariant .* this material is Ogden"
    ):
        PlaneLaw.of(plugin("material", "ogden")(), "plane_stress", "yeoh")


@pytest.mark.parametrize("state", STATES)
def test_divergence_against_differences_of_the_stress(state: str) -> None:
    """Without automatic differentiation, which asks the law for the same second derivatives as the divergence does."""
    law, step = PlaneLaw(LAW, state), 1e-4
    torch.manual_seed(1)
    place = torch.rand(20, 2, dtype=torch.double)

    def first(at: Tensor) -> Tensor:
        """Of u_x = 0.2 sin(2 x + z) and u_z = 0.3 x cos(1.5 z)."""
        x, z = at.T
        phase = (2 * x + z).cos()
        u_x = torch.stack([0.4 * phase, 0.2 * phase], dim=1)
        u_z = torch.stack([0.3 * (1.5 * z).cos(), -0.45 * x * (1.5 * z).sin()], dim=1)
        return torch.stack([u_x, u_z], dim=1)

    x, z = place.T
    bend, none = -0.2 * (2 * x + z).sin(), torch.zeros_like(x)
    u_x = torch.stack([4 * bend, bend, 2 * bend], dim=1)  # xx, zz, xz
    u_z = torch.stack([none, -0.675 * x * (1.5 * z).cos(), -0.45 * (1.5 * z).sin()], dim=1)
    along = step * torch.eye(2, dtype=torch.double)
    parts = [law.stress(first(place + each)) - law.stress(first(place - each)) for each in along]
    expected = (parts[0][:, :, 0] + parts[1][:, :, 1]) / (2 * step)
    found = law.divergence(first(place), torch.stack([u_x, u_z], dim=1))
    assert torch.allclose(found, expected, rtol=1e-6, atol=1e-7)
