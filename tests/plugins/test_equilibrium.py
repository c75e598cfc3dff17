"""The balance of forces of the whole body as a loss."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.body_balance import BodyBalance, body_balance
from pgdl_lab.learning.doubt import trained
from pgdl_lab.learning.jet import Jet
from pgdl_lab.learning.scene import Scene
from tests.trainings import training
from tests.whole import body, learnt, observed_body, whole_finger


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.of(whole_finger(), body())


@pytest.fixture(scope="module")
def balance(scene: Scene) -> BodyBalance:
    return body_balance(scene)


def test_nothing_is_out_of_balance_at_the_simulated_equilibria_and_all_is_at_rest(balance: BodyBalance) -> None:
    for displacement, kpa in zip(body().displacements, body().pressures_kpa, strict=True):
        assert balance.evaluated(displacement, float(kpa), slope=False)[0] < 1e-16
    rest = np.zeros_like(body().displacements[0])
    assert balance.evaluated(rest, 10.0, slope=False)[0] == pytest.approx(1)
    assert 0 < balance.evaluated(rest, 0.0, slope=False)[0] < 1


def test_between_the_equilibria_the_interpolation_leaves_a_trace(balance: BodyBalance) -> None:
    data = observed_body()
    left = [
        balance.evaluated(displacement, float(kpa), slope=False)[0]
        for displacement, kpa in zip(data.displacements, data.pressures_kpa, strict=True)
    ]
    assert max(left) < 1e-8


def test_the_way_back_is_the_derivative(balance: BodyBalance) -> None:
    rng, truth = np.random.default_rng(0), body().displacements[-1]
    place = truth + 0.02 * rng.standard_normal(truth.shape)
    tensor = torch.from_numpy(place).requires_grad_()
    share = balance.share(tensor, 7.0)
    (3 * share).backward()
    assert tensor.grad is not None
    step = 1e-6
    for _ in range(3):
        way = rng.standard_normal(truth.shape)
        ahead, behind = (balance.evaluated(place + sign * step * way, 7.0, slope=False)[0] for sign in (1, -1))
        assert 3 * (ahead - behind) / (2 * step) == pytest.approx(float((tensor.grad.numpy() * way).sum()), rel=1e-5)


def test_a_body_that_is_turned_inside_out_is_led_back(balance: BodyBalance) -> None:
    wild = 20 * np.random.default_rng(1).standard_normal(body().displacements[0].shape)
    share, slope = balance.evaluated(wild, 5.0, slope=True)
    assert np.isfinite(share) and slope is not None and np.isfinite(slope).all()
    assert (slope * wild).sum() > 0  # less of it is better


def test_the_loss_is_that_of_its_nodes_at_the_pressure_it_is_visited_at(scene: Scene, balance: BodyBalance) -> None:
    loss = plugin("loss", "equilibrium")()
    points, _ = loss.own_points(scene)
    assert np.array_equal(points, body().domain.points_mm)
    truth, kpa = torch.from_numpy(body().displacements[-1]), float(body().pressures_kpa[-1])
    at_truth = loss.value(Jet(truth[None], torch.full((len(truth),), kpa)), truth, scene)
    elsewhere = loss.value(Jet(truth[None], torch.full((len(truth),), kpa / 2)), truth, scene)
    assert float(at_truth) < 1e-12 < 1e-3 < float(elsewhere)


def test_a_network_that_sees_it_comes_nearer_to_balance(scene: Scene, balance: BodyBalance, tmp_path: Path) -> None:
    def left(losses: tuple[str, ...]) -> float:
        found = learnt(tmp_path / losses[-1], "mlp", losses, max_epochs=60, lr=1e-2, depth=2, width=24)
        return balance.evaluated(found.predict(scene.domain.points_mm, 6.0), 6.0, slope=False)[0]

    assert left(("data", "equilibrium")) < 0.5 * left(("data",))


def test_what_has_no_such_balance_is_refused(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Loss equilibrium balances the whole body: choose observation.of=body"):
        trained(plugin("model", "mlp")(depth=1, width=4), training(tmp_path, {"data": {}, "equilibrium": {}}))
    touched = replace(scene, provenance={**scene.provenance, "contact": {"acted": True}})
    with pytest.raises(InputError, match="a body whose surfaces do not touch"):
        plugin("loss", "equilibrium")().own_points(touched)
    with pytest.raises(InputError, match="Only a whole body that fem=solid simulated"):
        plugin("loss", "equilibrium")().own_points(replace(scene, provenance={}))
