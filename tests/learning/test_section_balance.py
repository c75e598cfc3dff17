"""The section's forces against what is known of them without the code under test."""

import numpy as np
import pytest
import torch
from torch import Tensor

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.jet import Jet
from pgdl_lab.learning.plane import PlaneLaw
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.section_balance import SectionBalance
from pgdl_lab.mechanics.finger import ExtrudedFinger
from tests.fingers import pneunet

discover()
P_MPA = torch.tensor(0.02, dtype=torch.double)


def section(state: str = "plane_strain", chambers: int = 2) -> SectionBalance:
    finger = pneunet(chambers=chambers)
    assert isinstance(finger, ExtrudedFinger)
    return SectionBalance(finger, PlaneLaw.of(finger.material, state, "section"), 6.0, 1.0)


def turned(points: Tensor, angle: float) -> Tensor:
    c, s = np.cos(angle), np.sin(angle)
    return points @ torch.tensor([[c, s], [-s, c]], dtype=torch.double) - points


@pytest.mark.parametrize("state", ["plane_stress", "plane_strain"])
def test_rigid_turns_need_no_stress_and_leave_the_norm_as_it_is(state: str) -> None:
    balance = section(state)
    points = torch.from_numpy(balance.points_mm)
    rest = balance.forces(torch.zeros_like(points), P_MPA) + balance.weight
    moved = balance.forces(turned(points, 1.2), P_MPA) + balance.weight
    assert torch.allclose(moved, rest + turned(rest, 1.2), atol=1e-10)  # of K · width · edge, about 1e3 N
    assert torch.allclose(balance.mean_square_strain(moved), balance.mean_square_strain(rest))


def test_closed_cavities_push_nowhere_and_weight_is_the_weight() -> None:
    """All forces add up to the weight of the section: pressure in closed cavities has no resultant."""
    balance, finger = section(), pneunet()
    torch.manual_seed(0)
    bent = 0.05 * torch.randn(len(balance.points_mm), 2, dtype=torch.double)
    total = balance.forces(bent, P_MPA).sum(dim=0)
    assert isinstance(finger, ExtrudedFinger)
    grid = finger.profile()
    area = np.diff(grid.x)[:, None] * np.diff(grid.z)
    width = np.choose(grid.regions, [0.0, finger.width_mm, 2 * finger.side_wall_mm])
    assert np.allclose(-total, (area * width).sum() * finger.body_force_n_mm3[::2], atol=1e-12)


def test_forces_derive_from_an_energy() -> None:
    """The work of the forces on a closed way is zero: their derivative is symmetric."""
    balance = section("plane_stress")
    torch.manual_seed(1)
    shape = len(balance.points_mm), 2
    at, one, other = (0.05 * torch.randn(shape, dtype=torch.double) for _ in range(3))

    def slope(along: Tensor) -> Tensor:
        return torch.func.jvp(lambda u: balance.forces(u, P_MPA), (at,), (along,))[1]

    assert float((slope(one) * other).sum()) == pytest.approx(float((slope(other) * one).sum()), rel=1e-9)


def test_the_sections_own_equilibrium_has_almost_no_residual() -> None:
    """A finger found by Newton's method on these forces: the loss vanishes there, and nowhere near."""
    balance = section("plane_stress", chambers=1)
    shape = balance.points_mm.shape
    free = balance.free
    u = torch.zeros(shape, dtype=torch.double)
    pressure = P_MPA
    for _ in range(8):
        forces = balance.forces(u, pressure)
        tangent = torch.func.jacfwd(
            lambda free_u: balance.forces(torch.zeros(shape, dtype=torch.double).index_add(0, free, free_u), pressure)[
                free
            ]
        )(u[free])
        step = torch.linalg.solve(tangent.reshape(forces[free].numel(), -1), forces[free].flatten())
        u = u.index_add(0, free, -step.reshape(-1, 2))
    assert u.abs().max() > 0.05
    assert balance.mean_square_strain(balance.forces(u, pressure)) < 1e-20
    assert balance.mean_square_strain(balance.forces(0.5 * u, pressure)) > 1e-8
    loss = plugin("loss", "section")(state="plane_stress")
    scene = Scene(
        Domain(np.empty((0, 2)), np.empty((0, 3), dtype=np.int64)), 20.0, 10.0, 0.5, (0.0, 0.0), pneunet(chambers=1)
    )
    assert np.array_equal(loss.own_points(scene)[0], balance.points_mm)
    for kpa, in_balance in ((20.0, True), (20.1, False)):
        jet = Jet(u[None], torch.full((len(u),), kpa, dtype=torch.double))
        assert (loss.value(jet, 0 * u, scene) < 1e-12) == in_balance


def test_pressure_widens_the_cavities() -> None:
    """The work on a body that grows by ε is 2 ε p V for the air V of one chamber and its channel, and gains energy."""
    balance = section(chambers=1)
    points = torch.from_numpy(balance.points_mm)
    pushed = balance.forces(torch.zeros_like(points), P_MPA) + balance.weight
    assert float((pushed * points).sum()) == pytest.approx(-2 * float(P_MPA) * 4.5 * 11 * 10)


def test_mean_square_strain_of_a_body_that_is_stretched() -> None:
    """The forces of G on u_x = γ x, whose strain is γ everywhere, are those of the stress μ γ."""
    balance, strain = section(), 0.03
    assert balance.points_mm[:, 0].min() == 0
    shear = pneunet().material.shear_modulus_mpa
    local = shear * strain * torch.einsum("eq,eaq->ea", balance.stiff, balance.gradients[..., 0])
    forces = torch.zeros(len(balance.points_mm), 2, dtype=torch.double)
    forces[:, 0].index_add_(0, balance.nodes.ravel(), local.ravel())
    assert float(balance.mean_square_strain(forces)) == pytest.approx(strain**2)


def test_a_finger_without_a_profile_is_told_from_none_at_all() -> None:
    loss = plugin("loss", "section")()
    with pytest.raises(InputError, match="a finger with a profile, but none is known; leave it out"):
        loss.check(None)
    with pytest.raises(InputError, match=r"a finger with a profile, but \w+ has none; leave it out"):
        loss.check(plugin("finger", "mesh")(path="examples/finger.msh"))
