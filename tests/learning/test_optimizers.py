import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.fit import fit
from pgdl_lab.learning.levenberg_marquardt import LevenbergMarquardt
from pgdl_lab.learning.module import surely_less
from pgdl_lab.learning.objective import Objective
from pgdl_lab.learning.stages import PATIENCE, Lbfgs
from tests.trainings import training

discover()
LOSSES: dict[str, Any] = {"data": {}, "boundary": {}}


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def small(**fields: Any) -> Any:
    return plugin("model", "mlp")(**{"depth": 1, "width": 12, "activation": "tanh", "dtype": "float64", **fields})


def last_loss(folder: Path, **settings: Any) -> float:
    history = fit(small(), training(folder, LOSSES, validation=0.0, **settings)).record.history
    return float(history[-1]["raw/data"])


def test_methods_with_curvature_beat_as_many_passes_of_adam(tmp_path: Path) -> None:
    adam = last_loss(tmp_path / "adam", name="adam", max_epochs=25)
    for name in ("lbfgs", "levenberg_marquardt"):
        # one iteration per epoch against four steps of Adam
        assert last_loss(tmp_path / name, name=name, max_epochs=25) < adam / 3, name


def test_levenberg_marquardt_solves_a_linear_problem_at_once(tmp_path: Path) -> None:
    """The last layer of a network is linear in its weights: one undamped step lands on the least-squares fit."""
    whole = training(tmp_path, {"data": {}})
    torch.manual_seed(0)
    field = small(interval=[0.0, 1.0]).new_field(whole)
    first, last = (layer for layer in field.layers if isinstance(layer, torch.nn.Linear))
    first.requires_grad_(False)
    objective = Objective(field, whole.losses, whole.samples, whole.scene, whole.balancing)
    everything = torch.arange(len(objective.cases))

    class LastLayer(LevenbergMarquardt):
        def _curvature(self) -> torch.Tensor:
            return super()._curvature()[-26:, -26:]  # 2 × 12 weights and 2 biases

    optimizer = LastLayer([last.weight, last.bias], objective)
    optimizer.param_groups[0]["damping"] = 0.0

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        total = objective.total(objective.terms(everything, torch.Generator()))
        total.backward()
        return total.detach()

    assert optimizer.improve(closure)
    reached = float(closure())
    hidden = torch.nn.Sequential(*list(field.layers)[:3])(torch.cat([objective.inputs[0], objective.cases], dim=1))
    design = torch.cat([hidden, torch.ones(len(hidden), 1)], dim=1)
    fitted = design @ torch.linalg.lstsq(design, objective.targets).solution
    assert reached == pytest.approx(float((fitted - objective.targets).square().sum(dim=1).mean()), rel=1e-6)


def test_optimisers_follow_each_other_and_say_why_they_end(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        history = fit(small(), training(tmp_path, LOSSES, name=["muon", "lbfgs"], max_epochs=8)).record.history
    assert "Optimizer muon ends after epoch 4: its share of the budget is spent." in caplog.text
    assert [entry["epoch"] for entry in history] == list(range(1, 9))
    assert history[-1]["raw/data"] < history[3]["raw/data"]


def test_lbfgs_ends_where_there_is_nothing_to_gain(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    whole = training(tmp_path, {"data": {"weight": 0.0}}, name="lbfgs", max_epochs=50)
    with caplog.at_level(logging.INFO):
        history = fit(small(), whole).record.history
    assert len(history) == 1
    assert "Optimizer lbfgs ends after epoch 1: the largest derivative of the loss is 0.0e+00." in caplog.text
    fit(small(), whole)  # and is not taken up again
    assert caplog.text.count("Optimizer lbfgs ends") == 1


@pytest.mark.parametrize("name", [["adam", "lbfgs"], "levenberg_marquardt"])
def test_resumed_training_ends_where_an_unbroken_one_ends(name: Any, tmp_path: Path) -> None:
    from lightning.pytorch.loggers.logger import DummyLogger

    class Killed(BaseException):
        pass

    class Killer(DummyLogger):
        def log_metrics(self, metrics: Any, step: Any = None) -> None:
            if step == 5:
                raise Killed

    settings: dict[str, Any] = {"max_epochs": 6, "checkpoint_every_s": 0, "name": name, "schedule": "constant"}
    whole: Any = fit(small(), training(tmp_path / "whole", LOSSES, **settings))
    with pytest.raises(Killed):
        fit(small(), training(tmp_path / "broken", LOSSES, logger=Killer(), **settings))
    resumed: Any = fit(small(), training(tmp_path / "broken", LOSSES, **settings))
    for ours, theirs in zip(whole.field.parameters(), resumed.field.parameters(), strict=True):
        assert torch.equal(ours, theirs)


def test_best_state_on_the_points_set_aside_is_kept(tmp_path: Path) -> None:
    """A learning rate that ruins a good start leaves the start."""
    model = plugin("model", "body")(depth=1, width=16, modes=32)
    surrogate: Any = fit(model, training(tmp_path, {"data": {}}, lr=3.0, schedule="constant", max_epochs=4))
    start = model.new_field(training(tmp_path, {"data": {}}))
    assert torch.equal(surrogate.field.linear.weight, start.linear.weight)
    assert surrogate.record.history[-1]["raw/data"] > 1


def test_a_gain_by_chance_is_none() -> None:
    torch.manual_seed(0)
    errors = torch.rand(500)
    assert not surely_less(errors + 0.1 * torch.randn(500), errors)
    assert not surely_less(errors, errors)
    assert surely_less(errors - 0.03 + 0.1 * torch.randn(500), errors)


@pytest.mark.parametrize("count", [2, 5, 400])
def test_a_sure_gain_is_three_standard_errors_of_the_logarithm(count: int) -> None:
    noise = np.random.default_rng(0).standard_normal(count)
    others = torch.ones(count, dtype=torch.double)
    for statistic, sure in ((2.9, False), (3.1, True)):
        gain = noise - noise.mean() + statistic * noise.std(ddof=1) / np.sqrt(count)
        assert scipy.stats.ttest_1samp(gain, 0).statistic == pytest.approx(statistic)
        gain *= min(1.0, 0.1 / np.abs(gain).max())  # too small to turn the means
        assert surely_less(others * torch.exp(-torch.from_numpy(gain)), others) == sure


def test_neither_one_error_nor_a_greater_mean_is_a_sure_gain() -> None:
    one = torch.tensor([1.0])
    assert not surely_less(1e-9 * one, one)
    others = torch.ones(100)
    errors = torch.full((100,), 0.1)
    assert surely_less(errors + 1e-3 * torch.rand(100), others)
    errors[0] = 1000.0  # less at all points but one
    assert not surely_less(errors, others)


@pytest.mark.parametrize(
    ("fields", "settings", "words"),
    [
        ({"dtype": "float32"}, {"name": ["adam", "lbfgs"]}, "set model.dtype=float64"),
        ({"width": 700}, {"name": "levenberg_marquardt"}, "takes at most 4000 weights, and this network has 4202"),
    ],
)
def test_what_an_optimiser_cannot_do_is_said(
    fields: dict[str, Any], settings: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        fit(small(**fields), training(tmp_path, LOSSES, **settings))


def test_lbfgs_remembers_through_a_checkpoint_for_how_long_nothing_was_gained() -> None:
    weight = torch.nn.Parameter(torch.zeros(1, dtype=torch.double))

    def closure() -> torch.Tensor:
        weight.grad = torch.ones_like(weight)  # a slope that leads nowhere
        return torch.ones((), dtype=torch.double)

    def steps(stage: Lbfgs, count: int) -> list[str | None]:
        return [stage.step(closure) for _ in range(count)]

    whole = steps(Lbfgs([weight]), PATIENCE + 1)
    assert whole[:-1] == [None] * PATIENCE and "no longer falls" in str(whole[-1])
    before, after = Lbfgs([weight]), Lbfgs([weight])
    assert steps(before, PATIENCE - 1) == whole[: PATIENCE - 1]
    after.restore(before.state())
    assert steps(after, 2) == whole[PATIENCE - 1 :]
