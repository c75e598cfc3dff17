from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from pgdl_lab.assessment.residuals import residuals
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import discover, names, plugin
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.jet import Jet
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.settings import OptimizerSettings
from tests.fingers import pneunet
from tests.synthetic import with_domain
from tests.trainings import scene, small, training

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


@pytest.mark.parametrize("name", ["data", "boundary"])
def test_distances_are_summed_over_components_and_averaged_over_points(name: str) -> None:
    jet = quadratic()
    target = jet.value + torch.tensor([[1.0, 2.0], [0.0, 3.0]])
    assert float(plugin("loss", name)().value(jet, target, scene(small()))) == pytest.approx((1 + 4 + 9) / 2)


def test_boundary_asks_for_the_clamp_to_rest() -> None:
    body = scene(small())
    points, targets = plugin("loss", "boundary")().own_points(body)
    assert (points[:, 0] == 0).all() and len(points) == len(body.domain.clamp) and not targets.any()


def test_boundary_refuses_a_body_without_a_clamp() -> None:
    with pytest.raises(InputError, match="clamped points"):
        plugin("loss", "boundary")().own_points(scene(with_domain(small(), clamp=small().domain.clamp[:0])))


@pytest.mark.parametrize(
    "fields",
    [{"form": "publshed"}, {"lame_mpa": -1.0}, {"shear_modulus_mpa": 0.0}, {"weight": -1.0}, {"weight": float("nan")}],
)
def test_navier_cauchy_refuses_nonsense(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        plugin("loss", "navier_cauchy")(**fields)


def real_scene() -> Scene:
    """The face of a small finger, with its law and profile."""
    finger = pneunet()
    face = finger.face(800)
    still = np.zeros((1, 800, 2))
    return Scene.of(finger, Dataset.path(face.domain, np.array([20.0]), still))


def test_outline_surrounds_the_face() -> None:
    """Gauss: the integral of x n_x over the outline is the area; the clamp lies at x = 0 and adds nothing."""
    scene = real_scene()
    middles, normals = scene.outline
    corners = scene.domain.points_mm[scene.domain.cells]
    legs = corners[:, 1:] - corners[:, :1]
    area = np.abs(legs[:, 0, 0] * legs[:, 1, 1] - legs[:, 0, 1] * legs[:, 1, 0]).sum() / 2
    tree = cKDTree(scene.domain.points_mm)
    nearest = tree.query(middles)[0]
    assert (2 * nearest * middles[:, 0] * normals[:, 0]).sum() == pytest.approx(area, rel=1e-9)
    assert (middles[:, 0] > 0).all()


def test_stress_free_turn_satisfies_yeoh_and_traction() -> None:
    """A rigid turn by 90° has no stress, so what is left of the residual is the weight."""
    scene = real_scene()
    count = len(scene.outline[0])
    rows = torch.zeros(6, count, 2, dtype=torch.double)
    rows[1], rows[2] = torch.tensor([-1.0, 1.0]), torch.tensor([-1.0, -1.0])
    for state in ("plane_stress", "plane_strain"):
        assert plugin("loss", "traction")(state=state).tractions(Jet(rows), scene).abs().max() < 1e-12
        left = plugin("loss", "yeoh")(state=state).residuals(Jet(rows), scene)
        assert torch.allclose(left, torch.tensor(scene.body_force_n_mm3, dtype=torch.double).expand(count, 2))


def test_traction_of_a_sheared_face_by_hand() -> None:
    """Small simple shear u_x = γ z: P N = μ γ (N_z, N_x)."""
    scene, shear = real_scene(), 1e-6
    _, normals = scene.outline
    rows = torch.zeros(3, len(normals), 2, dtype=torch.double)
    rows[2, :, 0] = shear
    found = plugin("loss", "traction")().tractions(Jet(rows), scene).numpy()
    assert np.allclose(found, scene.shear_modulus_mpa * shear * normals[:, ::-1], rtol=1e-4, atol=1e-11)


def test_yeoh_and_traction_are_the_means_of_their_squares() -> None:
    scene = real_scene()
    _, normals = scene.outline
    torch.manual_seed(0)
    jet = Jet(1e-2 * torch.randn(6, len(normals), 2, dtype=torch.double))
    yeoh, traction = plugin("loss", "yeoh")(), plugin("loss", "traction")()
    for loss, parts in ((yeoh, yeoh.residuals(jet, scene)), (traction, traction.tractions(jet, scene))):
        squares = sum(float(x) ** 2 + float(z) ** 2 for x, z in parts)
        assert float(loss.value(jet, jet.value, scene)) == pytest.approx(squares / len(normals)) and squares > 0


@pytest.mark.parametrize(
    "fields", [{"edge_mm": 0.0}, {"edge_mm": np.inf}, {"side_wall_share": 0.0}, {"side_wall_share": 1.01}]
)
def test_section_refuses_nonsense(fields: dict[str, Any]) -> None:
    plugin("loss", "section")(edge_mm=0.5, side_wall_share=1.0)
    with pytest.raises(InputError, match=next(iter(fields))):
        plugin("loss", "section")(**fields)


@pytest.mark.parametrize("name", ["yeoh", "traction", "section"])
@pytest.mark.parametrize("model", ["mlp", "body"])
def test_physics_trains_the_whole_field(name: str, model: str, tmp_path: Path) -> None:
    whole = training(tmp_path, {name: {"weight": 1.0}})
    body = real_scene()
    samples = Samples(body.domain.points_mm, Cases.path(np.full(800, 20.0)), 0.05 * body.domain.points_mm)
    fields = {"depth": 1, "width": 8} | ({"modes": 16} if model == "body" else {})
    whole = replace(whole, scene=body, samples=samples)
    history = plugin("model", model)(**fields).fit(replace(whole, optimizer=OptimizerSettings(lr=1e-4))).record.history
    assert 0 < history[-1][f"raw/{name}"] < history[0][f"raw/{name}"]


def test_residuals_of_the_truth_are_the_floor() -> None:
    """A surrogate that is the simulation has its residuals; that of data is zero."""
    body = real_scene()
    points = body.domain.points_mm[None]
    bent = 0.02 * points * points[..., ::-1] / 17
    snapshots = Dataset.path(body.domain, np.array([20.0]), bent)
    losses = {name: plugin("loss", name)() for name in ("data", "boundary", "navier_cauchy", "yeoh", "section")}
    same = residuals(losses, body, snapshots, bent, np.array([0]))
    other = residuals(losses, body, snapshots, 0 * bent, np.array([0]))
    assert same["data"]["fem"] == 0 and other["data"]["surrogate"] > 0
    for name in losses:
        assert same[name]["surrogate"] == same[name]["fem"] == other[name]["fem"]
        assert other[name]["surrogate"] == other[name]["rest"]


@pytest.mark.parametrize("name", ["yeoh", "traction", "section"])
def test_physics_refuses_what_it_cannot_do(name: str) -> None:
    with pytest.raises(InputError, match=r"plane_stres.*choose one of"):
        plugin("loss", name)(state="plane_stres")
    loss, unknown = plugin("loss", name)(), scene(small())
    with pytest.raises(InputError, match=f"Loss {name} .*leave it out"):
        loss.check(unknown.finger)
    with pytest.raises(InputError, match="this material is Ogden"):
        loss.check(pneunet(material=plugin("material", "ogden")()))


@pytest.mark.parametrize("name", ["navier_cauchy", "yeoh", "traction", "section"])
def test_physics_of_the_plane_refuses_gravity_across_it(name: str) -> None:
    loss = plugin("loss", name)()
    loss.check(pneunet(gravity_m_s2=[1.0, 0.0, -9.81]))
    with pytest.raises(InputError, match=rf"Loss {name} balances .*part along y.*leave this loss out"):
        loss.check(pneunet(gravity_m_s2=[0.0, 9.81, 0.0]))


@pytest.mark.parametrize("name", names("loss"))
def test_every_loss_says_where_its_minimum_lies(name: str) -> None:
    """At the simulated displacement or elsewhere: who weights it must know where it pulls to."""
    assert "minimum" in str(plugin("loss", name).__doc__)
