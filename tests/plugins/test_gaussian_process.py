from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.surrogate.triangulation import Triangulation
from tests.trainings import TRAIN, small, training

discover()


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Any:
    how = training(tmp_path_factory.mktemp("process"), {"data": {}, "boundary": {}})
    return plugin("model", "gaussian_process")(points=300, modes=24).fit(how)


def test_it_is_the_process_of_scikit_learn(fitted: Any) -> None:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF

    state, node = fitted.state(), 17
    # what was learnt from, with the noise on the diagonal and the mean taken off
    targets = state["weights_mm"].T @ (
        np.exp(-((state["inputs"][:, None] - state["inputs"]) ** 2).sum(axis=2) / 2)
        + state["noise"] * np.eye(len(state["inputs"]))
    )
    theirs = GaussianProcessRegressor(RBF(1.0), alpha=float(state["noise"]), optimizer=None)
    theirs.fit(state["inputs"], targets.T)
    asked = np.array([[*state["places"][node], 20.0 / state["unit_kpa"]]])
    mean, deviation = theirs.predict(asked, return_std=True)
    point = small().domain.points_mm[node : node + 1]
    assert fitted.predict(point, 20.0) == pytest.approx(mean + state["mean_mm"], abs=1e-6)
    count = np.interp(20.0, state["bar_kpa"], state["bar_deviations"])
    expected_mm = np.sqrt(deviation[0, 0] ** 2 + float(state["noise"])) * state["size_mm"] * count
    assert fitted.error_bar(point, 20.0) == pytest.approx([expected_mm], rel=2e-2)


def test_it_learns_and_knows_how_well(fitted: Any) -> None:
    data = small()
    error = fitted.predict(data.domain.points_mm, data.pressures_kpa) - data.displacements
    bars = fitted.error_bar(data.domain.points_mm, data.pressures_kpa)
    assert (error**2).mean() < 1e-2 * (data.displacements**2).mean()
    unseen = np.delete((np.abs(error) <= bars[..., None]).reshape(-1, 2), TRAIN, axis=0)
    assert 0.88 < unseen.mean() < 0.99
    assert np.median(fitted.error_bar(data.domain.points_mm, 75.0, beyond=True)) > 2 * np.median(
        fitted.error_bar(data.domain.points_mm, 50.0)
    )


def test_a_fit_repeats_exactly(tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}})
    first, second = (plugin("model", "gaussian_process")(points=50, modes=4).fit(how).state() for _ in range(2))
    for name, array in first.items():
        assert np.array_equal(array, second[name]), name


def test_settings_and_losses_are_checked(tmp_path: Path) -> None:
    model = plugin("model", "gaussian_process")
    with pytest.raises(InputError, match=r"model\.points is 0"):
        model(points=0)
    with pytest.raises(InputError, match="cannot take in loss navier_cauchy"):
        model().fit(training(tmp_path, {"data": {}, "navier_cauchy": {}}))


def test_a_fit_to_all_samples_is_that_of_scikit_learn_by_hand(tmp_path: Path) -> None:
    """Place as the slowest functions of the body, each by the root of its eigenvalue; pressure from 0 to 2."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    whole = training(tmp_path, {"data": {}})
    few = np.random.default_rng(1).choice(len(whole.samples.pressures_kpa), 80, replace=False)
    how = replace(whole, samples=whole.samples.at(few), held=whole.samples.at(few[:0]))
    surrogate = plugin("model", "gaussian_process")(points=5000, modes=4).fit(how)
    state = surrogate.state()

    body = Triangulation(how.scene.domain.points_mm, how.scene.domain.cells)
    functions, eigenvalues = body.modes(4)
    places = functions / np.sqrt(eigenvalues)
    places /= max(np.std(column) for column in places.T)
    samples = how.samples
    node = [np.flatnonzero((body.points_mm == point).all(axis=1))[0] for point in samples.points_mm]
    pressure = 2 * samples.pressures_kpa / samples.pressures_kpa.max()
    inputs = np.column_stack([places[node], pressure])
    mean_mm, size_mm = samples.displacements_mm.mean(axis=0), samples.displacements_mm.std(axis=0)
    kernel = ConstantKernel(1.0, (1e-3, 1e6)) * RBF(1.0, (1e-2, 1e3)) + WhiteKernel(1e-4, (1e-12, 1.0))
    theirs = GaussianProcessRegressor(kernel).fit(inputs, (samples.displacements_mm - mean_mm) / size_mm)

    found = theirs.kernel_
    variance, length = found.k1.k1.constant_value, found.k1.k2.length_scale
    assert state["unit_kpa"] == pytest.approx(samples.pressures_kpa.max() / 2 * length, rel=1e-3)
    assert state["size_mm"] == pytest.approx(np.sqrt(variance) * size_mm.max(), rel=1e-3)
    assert state["noise"] == pytest.approx(max(found.k2.noise_level / variance, 1e-10), rel=0.05)
    assert state["mean_mm"] == pytest.approx(mean_mm)
    np.testing.assert_allclose(np.abs(state["places"]), np.abs(places) / length, rtol=1e-3, atol=1e-6)
    kpa = 35.0
    asked = np.column_stack([places, np.full(len(places), 2 * kpa / samples.pressures_kpa.max())])
    wanted = theirs.predict(asked) * size_mm + mean_mm
    np.testing.assert_allclose(surrogate.predict(body.points_mm, kpa), wanted, atol=1e-3 * size_mm.max())

    probe, step = surrogate.probe(body.points_mm), 1e-3
    slope = (probe.value(kpa + step) - probe.value(kpa - step)) / (2 * step)
    np.testing.assert_allclose(probe.slope(kpa), slope, atol=1e-6 * np.abs(slope).max())


def test_one_point_is_enough_and_5000_are_the_most() -> None:
    model = plugin("model", "gaussian_process")
    model(points=1, modes=1)
    model(points=5000)
    with pytest.raises(InputError, match="model.points is 5001; 5000 are the most"):
        model(points=5001)
