from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.learning.last_layer import BEYOND, STATE, LastLayer
from pgdl_lab.registry import discover, plugin
from tests.trainings import TRAIN, small, training

discover()
ONE = np.ones(1)
SAME = np.ones((len(BEYOND), 1))


def straight(
    count: int, held: int = 0, noise_mm: float = 0.1, bend: float = 0.0, seed: int = 0
) -> tuple[Any, LastLayer]:
    """Samples of a line in the pressure, with noise and a bend, and error bars of the fit with features 1 and p."""
    rng = np.random.default_rng(seed)
    kpa = rng.uniform(0, 50, count)
    targets = np.stack([kpa, -kpa], axis=1) / 50 + noise_mm * rng.standard_normal((count, 2))
    targets += bend * (kpa[:, None] / 50) ** 3
    place = np.stack([np.ones(count), kpa / 50], axis=1)
    aside = np.arange(count) < held
    weights = np.linalg.lstsq(place[~aside], targets[~aside])[0]
    given = (place, np.ones((count, 1))), kpa, targets, place @ weights - targets, aside
    return given, LastLayer.fitted(*given, SAME)


def at(layer: LastLayer, kpa: float) -> float:
    return float(layer.bars(np.array([[1.0, kpa / 50]]), ONE, kpa)[0])


@pytest.mark.parametrize("held", [0, 2000])
def test_bars_are_those_of_the_noise_where_there_are_many_points(held: int) -> None:
    _, layer = straight(6000, held)
    assert at(layer, 10.0) == pytest.approx(1.96 * 0.1, rel=0.1)
    assert at(layer, 40.0) == pytest.approx(1.96 * 0.1, rel=0.1)


def test_a_few_points_are_judged_as_if_each_were_left_out() -> None:
    # the residuals of 6 points from a line are 0.82 of the noise, errors at new points 1.15 of it
    found = [at(straight(6, seed=seed)[1], 25.0) for seed in range(200)]
    assert np.mean(found) > 1.3 * 0.1
    assert np.mean([np.abs(straight(6, seed=seed)[0][3]).max() for seed in range(200)]) < np.mean(found)


def test_bars_grow_beyond_the_pressures_by_what_a_fit_below_missed() -> None:
    _, even = straight(4000)
    _, bent = straight(4000, bend=1.0)
    assert at(even, 56.0) < 1.2 * at(even, 50.0)
    assert at(bent, 56.0) > 1.2 * at(bent, 50.0) and at(bent, 75.0) > at(bent, 56.0)


def test_bars_of_polynomials_in_the_pressure_grow_as_those_of_many_fits_spread() -> None:
    rng = np.random.default_rng(2)
    kpa, highest = rng.uniform(0, 50, 2000), 50.0
    kpa[0] = highest

    def orders(of: Any) -> Any:
        return np.vander(np.atleast_1d(of) / highest, 4)

    noise = 0.1 * rng.standard_normal((2000, 2))
    above = orders((1 + BEYOND) * highest)
    layer = LastLayer.fitted((np.ones((2000, 1)), orders(kpa)), kpa, noise, noise, np.zeros(2000, dtype=bool), above)
    asked = (1 + BEYOND[[1, 3, 5]]) * highest
    many = np.linalg.lstsq(orders(kpa), rng.standard_normal((2000, 500)))[0]
    spread = (orders(asked) @ many).std(axis=1) / (orders(highest) @ many).std()
    bars = [layer.bars(np.ones((1, 1)), orders(each)[0], each)[0] for each in (highest, *asked)]
    assert np.array(bars[1:]) / bars[0] == pytest.approx(spread, rel=0.1)


def test_products_of_place_and_pressure_are_one_regression() -> None:
    rng = np.random.default_rng(1)
    place, orders = rng.standard_normal((500, 4)), rng.standard_normal((500, 3))
    kpa, targets = rng.uniform(1, 50, 500), rng.standard_normal((500, 2))
    errors, held = 0.1 * targets, np.zeros(500, dtype=bool)
    layer = LastLayer.fitted((place, orders), kpa, targets, errors, held, rng.standard_normal((len(BEYOND), 3)))
    products = np.einsum("nk,nh->nkh", orders, place).reshape(500, -1)
    plain = LastLayer.fitted((products, np.ones((500, 1))), kpa, targets, errors, held, SAME)
    for i in range(5):
        several = layer.bars(place[i : i + 1], orders[i], float(kpa[i]))
        assert several == pytest.approx(plain.bars(products[i : i + 1], ONE, float(kpa[i])), rel=1e-4)


@pytest.mark.parametrize("name", ["mlp", "body"])
@pytest.mark.parametrize("validation", [0.0, 0.2])
def test_bars_of_networks_cover_the_unseen_points(name: str, validation: float, tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}}, max_epochs=40, validation=validation)
    surrogate, data = plugin("model", name)(depth=2, width=16).fit(how), small()
    error = np.abs(surrogate.predict(data.points, data.pressures_kpa) - data.displacements)
    bars = surrogate.error_bar(data.points, data.pressures_kpa)
    covered = (error <= bars[..., None]).reshape(-1, 2)
    assert 0.9 < np.delete(covered, TRAIN, axis=0).mean() < 0.99
    assert np.median(surrogate.error_bar(data.points, 60.0)) > np.median(surrogate.error_bar(data.points, 50.0))


def test_a_network_stored_without_bars_has_none(tmp_path: Path) -> None:
    model = plugin("model", "mlp")(depth=1, width=8)
    surrogate = model.fit(training(tmp_path, {"data": {}}, max_epochs=1))
    bare = {name: array for name, array in surrogate.state().items() if not name.startswith(STATE)}
    assert model.restore(bare, surrogate.record).error_bar([[1.0, 1.0]], 10.0) is None


def test_features_and_the_last_layer_give_the_field(tmp_path: Path) -> None:
    for name in ("mlp", "body"):
        field = plugin("model", name)(depth=2, width=8, dtype="float64").new_field(training(tmp_path, {"data": {}}))
        torch.nn.init.normal_((field.deep if name == "body" else field.layers[:-1])[-1].weight)
        coordinates, kpa = field.coordinates(small().points[::9], 0), torch.tensor(30.0, dtype=torch.double)
        kpa = kpa.expand(coordinates.shape[1])
        with torch.no_grad():
            place, pressure = field.features(coordinates, kpa)
            products = torch.einsum("nh,nk->nkh", place, pressure).flatten(1)
            given = field(coordinates, kpa) - field.beside(coordinates, kpa)
        # what the last layer gives is linear in the products
        weights = torch.linalg.lstsq(products, given, driver="gelsd").solution
        assert (products @ weights).numpy() == pytest.approx(given.numpy(), abs=1e-8)
        assert given.abs().max() > 1e-2
