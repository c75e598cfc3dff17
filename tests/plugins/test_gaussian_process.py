from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.errors import InputError
from pgdl_lab.registry import discover, plugin
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
    point = small().points[node : node + 1]
    assert fitted.predict(point, 20.0) == pytest.approx(mean + state["mean_mm"], abs=1e-6)
    count = np.interp(20.0, state["bar_kpa"], state["bar_deviations"])
    expected_mm = np.sqrt(deviation[0, 0] ** 2 + float(state["noise"])) * state["size_mm"] * count
    assert fitted.error_bar(point, 20.0) == pytest.approx([expected_mm], rel=2e-2)


def test_it_learns_and_knows_how_well(fitted: Any) -> None:
    data = small()
    error = fitted.predict(data.points, data.pressures_kpa) - data.displacements
    bars = fitted.error_bar(data.points, data.pressures_kpa)
    assert (error**2).mean() < 1e-2 * (data.displacements**2).mean()
    unseen = np.delete((np.abs(error) <= bars[..., None]).reshape(-1, 2), TRAIN, axis=0)
    assert 0.88 < unseen.mean() < 0.99
    assert np.median(fitted.error_bar(data.points, 75.0, beyond=True)) > 2 * np.median(
        fitted.error_bar(data.points, 50.0)
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
