"""Budgets of time and of threads hold for every model."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

from pgdl_lab.core.registry import discover, names, plugin
from pgdl_lab.learning import clock
from pgdl_lab.learning.module import TrainingModule
from pgdl_lab.learning.separable import SeparableRegression
from pgdl_lab.surrogate.triangulation import Triangulation
from tests.trainings import small, training

discover()
QUICK: dict[str, dict[str, Any]] = {
    "body": {"depth": 1, "width": 16, "modes": 32, "degree": 2},
    "gaussian_process": {"points": 100, "modes": 8},
    "hybrid": {"degree": 3},
    "mlp": {"depth": 1, "width": 8},
}


@pytest.mark.parametrize("name", names("model"))
def test_a_budget_that_is_spent_at_once_leaves_little_to_do(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Each fit of a closed form and each step takes a second of one that is there."""
    at, done = [0.0], {"fits": 0, "steps": 0}
    monkeypatch.setattr(clock, "now", lambda: at[0])

    def counted(cls: type, method: str, what: str) -> None:
        inner = getattr(cls, method)

        def work(*args: Any, **named: Any) -> Any:
            at[0] += 1.0
            done[what] += 1
            return inner(*args, **named)

        monkeypatch.setattr(cls, method, work)

    counted(SeparableRegression, "posterior", "fits")
    counted(TrainingModule, "_take_step", "steps")
    how = training(tmp_path, {"data": {}}, max_time="1", max_epochs=10**6)
    surrogate = plugin("model", name)(**QUICK.get(name, {})).fit(how)
    assert done["fits"] <= 3 and done["steps"] <= 1
    point = small().domain.points_mm[:5], 30.0
    assert np.isfinite(surrogate.predict(*point)).all()
    if done["fits"]:
        assert surrogate.error_bar(*point) is None and "no time to calibrate error bars" in caplog.text


def test_a_process_is_not_searched_for_longer_than_there_is_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from sklearn.gaussian_process import GaussianProcessRegressor

    at, asked = [0.0], []
    monkeypatch.setattr(clock, "now", lambda: at[0])
    likelihood = GaussianProcessRegressor.log_marginal_likelihood

    def slow(*args: Any, **named: Any) -> Any:
        at[0] += 1.0
        asked.append(at[0])
        return likelihood(*args, **named)

    monkeypatch.setattr(GaussianProcessRegressor, "log_marginal_likelihood", slow)
    model = plugin("model", "gaussian_process")(**QUICK["gaussian_process"])
    model.fit(training(tmp_path, {"data": {}}, max_time="1"))
    short = len(asked)
    model.fit(training(tmp_path, {"data": {}}, max_time="1000"))
    assert short <= 4 < len(asked) - short


@pytest.mark.parametrize("name", names("model"))
def test_threads_are_limited_whatever_is_fitted(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[int] = []

    def watched(cls: type, method: str) -> None:
        inner = getattr(cls, method)

        def work(*args: Any, **named: Any) -> Any:
            found.append(max(torch.get_num_threads(), *(library["num_threads"] for library in threadpool_info())))
            return inner(*args, **named)

        monkeypatch.setattr(cls, method, work)

    for cls, method in (
        (SeparableRegression, "__init__"), (SeparableRegression, "posterior"), (Triangulation, "__init__"),
        (Triangulation, "modes"), (TrainingModule, "_take_step"), (TrainingModule, "settle"),
    ):  # fmt: skip
        watched(cls, method)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with threadpool_limits(2):
            plugin("model", name)(**QUICK.get(name, {})).fit(training(tmp_path, {"data": {}}, max_epochs=1, threads=1))
            assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert found and max(found) == 1
