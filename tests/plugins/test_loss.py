import pytest
import torch

from pgdl_lab.errors import InputError
from pgdl_lab.learning.jet import Jet
from pgdl_lab.registry import discover, plugin
from tests.trainings import scene, small

discover()
LAME, SHEAR, FORCE_Z = 10.0, 0.5, -1e-5  # those of `scene`


def quadratic() -> Jet:
    """u_x = x² + 3 x z, u_z = 2 z² − x z at (1, 2) and (0, −1), derivatives by hand."""
    x, z = torch.tensor([[1.0, 2.0], [0.0, -1.0]], dtype=torch.double).T
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    rows = [
        (x**2 + 3 * x * z, 2 * z**2 - x * z),
        (2 * x + 3 * z, -z),  # ∂x
        (3 * x, 4 * z - x),  # ∂z
        (2 * one, zero),  # ∂xx
        (zero, 4 * one),  # ∂zz
        (3 * one, -one),  # ∂xz
    ]
    return Jet(torch.stack([torch.stack(row, dim=1) for row in rows]))


def test_corrected_navier_cauchy_by_hand() -> None:
    f, g = plugin("loss", "navier_cauchy")(form="corrected").residuals(quadratic(), scene(small()))
    # ∇(∇·u) = (u_x,xx + u_z,xz, u_x,xz + u_z,zz) = (2 − 1, 3 + 4); ∇²u = (2, 4)
    assert f.tolist() == pytest.approx([(LAME + SHEAR) * 1 + SHEAR * 2] * 2)
    assert g.tolist() == pytest.approx([(LAME + SHEAR) * 7 + SHEAR * 4 + FORCE_Z] * 2)


def test_published_navier_cauchy_by_hand() -> None:
    f, g = plugin("loss", "navier_cauchy")(form="published").residuals(quadratic(), scene(small()))
    # ∂x(u_x + u_z) = 2 x + 2 z and ∂z(u_x + u_z) = 2 x + 4 z
    assert f.tolist() == pytest.approx([(LAME + SHEAR) * 6 + SHEAR * 2, (LAME + SHEAR) * -2 + SHEAR * 2])
    assert g.tolist() == pytest.approx(
        [(LAME + SHEAR) * 10 + SHEAR * 4 + FORCE_Z, (LAME + SHEAR) * -4 + SHEAR * 4 + FORCE_Z]
    )


def test_own_moduli_replace_the_fingers() -> None:
    loss = plugin("loss", "navier_cauchy")(form="corrected", lame_mpa=1.0, shear_modulus_mpa=2.0)
    f, _ = loss.residuals(quadratic(), scene(small()))
    assert f.tolist() == pytest.approx([3 * 1 + 2 * 2] * 2)


def test_navier_cauchy_is_the_mean_of_both_squares() -> None:
    loss, jet, body = plugin("loss", "navier_cauchy")(), quadratic(), scene(small())
    f, g = loss.residuals(jet, body)
    assert float(loss.value(jet, jet.value, body)) == pytest.approx(float((f**2 + g**2).mean()))


def test_data_sums_over_components_and_averages_over_points() -> None:
    jet = quadratic()
    target = jet.value + torch.tensor([[1.0, 2.0], [0.0, 3.0]])
    assert float(plugin("loss", "data")().value(jet, target, scene(small()))) == pytest.approx((1 + 4 + 9) / 2)


def test_boundary_asks_for_the_clamp_to_rest() -> None:
    body = scene(small())
    points, targets = plugin("loss", "boundary")().own_points(body)
    assert (points[:, 0] == 0).all() and len(points) == len(body.clamp) and not targets.any()


def test_boundary_refuses_a_body_without_a_clamp() -> None:
    from dataclasses import replace

    with pytest.raises(InputError, match="clamped points"):
        plugin("loss", "boundary")().own_points(replace(scene(small()), clamp=small().clamp[:0]))


@pytest.mark.parametrize(
    "fields", [{"form": "publshed"}, {"lame_mpa": -1.0}, {"weight": -1.0}, {"weight": float("nan")}]
)
def test_navier_cauchy_refuses_nonsense(fields: dict[str, object]) -> None:
    with pytest.raises(InputError):
        plugin("loss", "navier_cauchy")(**fields)
