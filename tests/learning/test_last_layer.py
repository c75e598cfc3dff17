from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from sklearn.linear_model import BayesianRidge

from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.surrogate.calibration import covering_line
from pgdl_lab.surrogate.last_layer import BEYOND, STATE, LastLayer, ridge_regression, scores
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


@pytest.mark.parametrize("noise", [0.01, 3.0])
def test_the_likeliest_ridge_is_that_of_scikit_learn(noise: float) -> None:
    rng = np.random.default_rng(3)
    features = rng.standard_normal((120, 6)) * [3.0, 2.0, 1.0, 1.0, 0.5, 0.2]
    targets = features @ rng.standard_normal((6, 2)) + noise * rng.standard_normal((120, 2))
    theirs = BayesianRidge(fit_intercept=False, alpha_1=0, alpha_2=0, lambda_1=0, lambda_2=0, max_iter=2000, tol=1e-9)
    theirs.fit(np.kron(np.eye(2), features), targets.T.ravel())  # both components share what is weighed
    root, weights, rho = ridge_regression(features, targets)
    assert rho == pytest.approx(theirs.lambda_ / theirs.alpha_, rel=1e-2)
    assert weights.T.ravel() == pytest.approx(theirs.coef_, rel=1e-3)
    assert root @ root.T == pytest.approx(np.linalg.inv(features.T @ features + rho * np.eye(6)))


def test_bars_are_those_of_fits_without_each_sample() -> None:
    rng = np.random.default_rng(4)
    place, kpa = rng.standard_normal((40, 3)), rng.uniform(1, 50, 40)
    targets = place @ rng.standard_normal((3, 2)) + 0.3 * rng.standard_normal((40, 2))
    _, weights, rho = ridge_regression(place, targets)

    def without(out: Any) -> Any:
        rest, theirs = np.delete(place, out, axis=0), np.delete(targets, out, axis=0)
        return np.linalg.solve(rest.T @ rest + rho * np.eye(3), rest.T @ theirs)

    def variance(at: Any) -> Any:
        return 1 + np.einsum("nf,fg,ng->n", at, np.linalg.inv(place.T @ place + rho * np.eye(3)), at)

    alone = np.array([place[i] @ without(i) - targets[i] for i in range(40)])
    given = (place, np.ones((40, 1))), kpa, targets, place @ weights - targets, np.zeros(40, dtype=bool), SAME
    asked = rng.standard_normal((5, 3))
    line = covering_line(kpa / kpa.max(), np.abs(alone) / np.sqrt(variance(place))[:, None])
    expected = np.interp(20.0 / kpa.max(), [0, 1], line) * np.sqrt(variance(asked))
    assert LastLayer.fitted(*given).bars(asked, ONE, 20.0) == pytest.approx(expected, rel=1e-5)
    # where networks were trained without each sample, what they err by counts instead
    known = np.abs(rng.standard_normal((40, 2)))
    line = covering_line(kpa / kpa.max(), known)
    expected = np.interp(20.0 / kpa.max(), [0, 1], line) * np.sqrt(variance(asked))
    assert LastLayer.fitted(*given, known).bars(asked, ONE, 20.0) == pytest.approx(expected, rel=1e-5)
    # such scores are errors by the root of their variance
    found = scores(known, (place, np.ones((40, 1))), (place, np.ones((40, 1))), rho)
    assert found == pytest.approx(known / np.sqrt(variance(place))[:, None])


@pytest.mark.parametrize("held", [0, 1000])
def test_bars_follow_an_error_that_grows_with_the_pressure(held: int) -> None:
    rng = np.random.default_rng(5)
    kpa = rng.uniform(0, 50, 2000)
    errors = np.where(kpa < 20, 0.1, 0.4)[:, None] * rng.standard_normal((2000, 2))
    aside = np.arange(2000) < held
    if held:
        errors[~aside] = 1e-3  # what was trained on was learnt by heart, which tells nothing
    layer = LastLayer.fitted((np.ones((2000, 1)), np.ones((2000, 1))), kpa, errors, errors, aside, SAME)
    for asked, size in ((2.0, 0.1), (8.0, 0.1), (30.0, 0.4), (48.0, 0.4)):
        assert layer.bars(np.ones((1, 1)), ONE, asked)[0] == pytest.approx(1.96 * size, rel=0.12)


def test_bars_beyond_grow_by_what_a_fit_below_missed_and_no_faster() -> None:
    """A step of 2 mm at 44 kPa, which a constant fitted below misses: (2² − 0²)^½, reached 12 % above the highest."""
    kpa = np.arange(1, 801) / 16
    targets = np.repeat(np.where(kpa > 44, 2.0, 0.0)[:, None], 2, axis=1)
    one = np.ones((800, 1))
    layer = LastLayer.fitted((one, one), kpa, targets, np.zeros((800, 2)), np.arange(800) < 0, SAME)
    assert layer.kpa[-len(BEYOND) :] == pytest.approx((1 + BEYOND) * 50)
    assert layer.bar_mm[-len(BEYOND) :] == pytest.approx(2 * np.minimum(BEYOND / 0.12, 1), rel=2e-3)
    assert layer.kpa[-len(BEYOND) - 1] == 50 and layer.bar_mm[-len(BEYOND) - 1] == 0


def test_where_nothing_is_to_be_learnt_bars_are_those_of_the_errors() -> None:
    kpa, none = np.linspace(1, 50, 30), np.zeros((30, 2))
    place = np.stack([np.ones(30), kpa], axis=1)
    given = (place, np.ones((30, 1))), kpa, none, np.full((30, 2), 0.2), np.zeros(30, dtype=bool), SAME
    assert LastLayer.fitted(*given).bars(place[:3], ONE, 20.0) == pytest.approx(0.2)


def test_bars_grow_beyond_the_pressures_by_what_a_fit_below_missed() -> None:
    _, even = straight(4000)
    _, bent = straight(4000, bend=1.0)
    assert at(even, 56.0) < 1.2 * at(even, 50.0)
    assert at(bent, 56.0) > 1.2 * at(bent, 50.0) and at(bent, 75.0) > at(bent, 56.0)


def test_bars_of_polynomials_in_the_pressure_grow_as_those_of_many_fits_spread() -> None:
    rng = np.random.default_rng(2)
    kpa, highest = 50 * np.sqrt(rng.random(2000)), 50.0  # fewer of low pressures: less is known of these
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


def test_bars_come_back_from_a_state_or_not_at_all() -> None:
    _, layer = straight(50)
    state = layer.state()
    again = LastLayer.restored({**state, "weights": np.ones(3)})
    assert again is not None and at(again, 55.0) == at(layer, 55.0) > 0
    for missing in state:
        assert LastLayer.restored({name: array for name, array in state.items() if name != missing}) is None


@pytest.mark.parametrize("name", ["mlp", "body"])
@pytest.mark.parametrize("validation", [0.0, 0.2])
def test_bars_of_networks_cover_the_unseen_points(name: str, validation: float, tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}}, max_epochs=40, validation=validation)
    surrogate, data = plugin("model", name)(depth=2, width=16).fit(how), small()
    error = np.abs(surrogate.predict(data.domain.points_mm, data.pressures_kpa) - data.displacements)
    bars = surrogate.error_bar(data.domain.points_mm, data.pressures_kpa)
    covered = (error <= bars[..., None]).reshape(-1, 2)
    assert 0.9 < np.delete(covered, TRAIN, axis=0).mean() < 0.99
    assert np.median(surrogate.error_bar(data.domain.points_mm, 60.0)) > np.median(
        surrogate.error_bar(data.domain.points_mm, 50.0)
    )


def test_a_network_stored_without_bars_has_none(tmp_path: Path) -> None:
    model = plugin("model", "mlp")(depth=1, width=8)
    surrogate = model.fit(training(tmp_path, {"data": {}}, max_epochs=1))
    bare = {name: array for name, array in surrogate.state().items() if not name.startswith(STATE)}
    assert model.restore(bare, surrogate.record).error_bar([[1.0, 1.0]], 10.0) is None


def test_features_and_the_last_layer_give_the_field(tmp_path: Path) -> None:
    for name in ("mlp", "body"):
        field = plugin("model", name)(depth=2, width=8, dtype="float64").new_field(training(tmp_path, {"data": {}}))
        torch.nn.init.normal_((field.deep if name == "body" else field.layers[:-1])[-1].weight)
        coordinates, kpa = field.coordinates(small().domain.points_mm[::9], 0), torch.tensor(30.0, dtype=torch.double)
        kpa = kpa.expand(coordinates.shape[1], 1)
        with torch.no_grad():
            place, pressure = field.features(coordinates, kpa)
            products = torch.einsum("nh,nk->nkh", place, pressure).flatten(1)
            given = field(coordinates, kpa) - field.beside(coordinates, kpa)
        # what the last layer gives is linear in the products
        weights = torch.linalg.lstsq(products, given, driver="gelsd").solution
        assert (products @ weights).numpy() == pytest.approx(given.numpy(), abs=1e-8)
        assert given.abs().max() > 1e-2
