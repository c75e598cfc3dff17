import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.model import Model
from pgdl_lab.learning.module import TrainingDiverged, TrainingModule
from tests.trainings import TRAIN, small, training

discover()
LOSSES: dict[str, Any] = {"data": {}, "boundary": {}, "navier_cauchy": {"weight": 1e-3}}


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def mlp(**fields: Any) -> Model:
    model = plugin("model", "mlp")(**{"depth": 2, "width": 16, **fields})
    assert isinstance(model, Model)
    return model


def body(**fields: Any) -> Model:
    model = plugin("model", "body")(**{"depth": 1, "width": 16, "modes": 32, **fields})
    assert isinstance(model, Model)
    return model


def weights(surrogate: Any) -> torch.Tensor:
    return torch.cat([weight.flatten() for weight in surrogate.field.parameters()])


@pytest.mark.parametrize("model", [mlp(), body()], ids=["mlp", "body"])
def test_training_repeats_under_a_seed(model: Model, tmp_path: Path) -> None:
    runs = [model.fit(training(tmp_path / name, LOSSES)) for name in "ab"]
    other = model.fit(training(tmp_path / "c", LOSSES, seed=1))
    assert torch.equal(weights(runs[0]), weights(runs[1]))
    assert not torch.equal(weights(runs[0]), weights(other))


def test_body_learns_what_the_plane_hides(tmp_path: Path) -> None:
    data = small()
    unseen = np.setdiff1d(np.arange(data.displacements.size // 2), TRAIN)
    mse = {}
    for name, model in (("mlp", mlp(width=32)), ("body", body(modes=64, width=32))):
        trained = model.fit(training(tmp_path / name, {"data": {}}, max_epochs=60, batch_size=128))
        error = trained.predict(data.domain.points_mm, data.pressures_kpa) - data.displacements
        mse[name] = (error.reshape(-1, 2)[unseen] ** 2).mean()
    assert mse["body"] < 0.2 and mse["body"] < mse["mlp"] / 10


@pytest.mark.parametrize(("gained", "epochs"), [(False, 4), (True, 12)])
def test_patience_ends_with_gains_that_may_be_chance(
    gained: bool, epochs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(TrainingModule, "_gained", lambda _: gained)
    given = training(tmp_path, {"data": {}}, max_epochs=12, batch_size=128, validation=0.2)
    history = mlp(patience=4).fit(given).record.history
    validation = [entry["validation"] for entry in history]
    assert validation[-1] < validation[0]  # it is getting better all the time
    assert history[-1]["epoch"] == epochs


def test_history_has_raw_weighted_and_shares(tmp_path: Path) -> None:
    history = mlp().fit(training(tmp_path, LOSSES)).record.history
    assert [entry["epoch"] for entry in history] == [1, 2, 3]
    for entry in history:
        assert entry["weighted/navier_cauchy"] == pytest.approx(1e-3 * entry["raw/navier_cauchy"])
        assert sum(entry[f"share/{name}"] for name in LOSSES) == pytest.approx(1)
        assert entry["loss"] == pytest.approx(sum(entry[f"weighted/{name}"] for name in LOSSES))


def test_logger_gets_one_entry_per_epoch(tmp_path: Path) -> None:
    from lightning.pytorch.loggers.logger import DummyLogger

    entries = []

    class Listener(DummyLogger):
        def log_metrics(self, metrics: Any, step: Any = None) -> None:
            entries.append((step, metrics))

    mlp().fit(training(tmp_path, LOSSES, logger=Listener()))
    assert [step for step, _ in entries] == [1, 2, 3]
    assert {"loss", "lr", "raw/data", "share/boundary"} <= entries[0][1].keys()


class Killed(BaseException):
    """Stands for kill −9: no handler sees it."""


@pytest.mark.parametrize("model", [mlp(), body()], ids=["mlp", "body"])
def test_resumed_training_ends_where_an_unbroken_one_ends(
    model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lightning.pytorch.loggers.logger import DummyLogger

    class Killer(DummyLogger):
        def log_metrics(self, metrics: Any, step: Any = None) -> None:
            if step == 4:
                raise Killed

    settings: dict[str, Any] = {"max_epochs": 6, "checkpoint_every_s": 0}
    whole = model.fit(training(tmp_path / "whole", LOSSES, **settings))
    with pytest.raises(Killed):
        model.fit(training(tmp_path / "broken", LOSSES, logger=Killer(), **settings))
    assert (tmp_path / "broken/checkpoints/last.ckpt").exists()
    resumed = model.fit(training(tmp_path / "broken", LOSSES, **settings))
    assert torch.equal(weights(whole), weights(resumed))
    assert [entry["epoch"] for entry in resumed.record.history] == [1, 2, 3, 4, 5, 6]
    assert not list((tmp_path / "broken/checkpoints").glob(".*"))


def test_finished_training_is_not_trained_again(tmp_path: Path) -> None:
    first = mlp().fit(training(tmp_path, LOSSES))
    again = mlp().fit(training(tmp_path, LOSSES))
    assert torch.equal(weights(first), weights(again)) and first.record.history == again.record.history


def test_time_before_a_resume_counts(tmp_path: Path) -> None:
    first = mlp().fit(training(tmp_path, LOSSES, max_time="0.3", max_epochs=10**6))
    assert 0.2 <= first.record.history[-1]["seconds"] < 5
    again = mlp().fit(training(tmp_path, LOSSES, max_time="0.3", max_epochs=10**6))
    assert torch.equal(weights(first), weights(again))


def test_larger_budget_goes_on(tmp_path: Path) -> None:
    mlp().fit(training(tmp_path, LOSSES, max_epochs=2))
    longer = mlp().fit(training(tmp_path, LOSSES, max_epochs=4))
    assert [entry["epoch"] for entry in longer.record.history] == [1, 2, 3, 4]


def test_divergence_stops_and_keeps_the_last_good_weights(tmp_path: Path) -> None:
    samples = training(tmp_path, LOSSES).samples
    with pytest.raises(TrainingDiverged, match=r"epoch \d+: .*lower optimizer.lr \(1e\+30\)") as caught:
        mlp(activation="relu").fit(training(tmp_path, {"data": {}}, lr=1e30, schedule="constant", max_epochs=50))
    prediction = caught.value.surrogate.predict(samples.points_mm[:3], 10.0)
    assert np.isfinite(prediction).all()


@pytest.mark.parametrize(
    ("model", "changes", "named"),
    [
        (mlp(depth=3), {}, "model.depth is 2 there and 3 here"),
        (mlp(), {"seed": 1}, "seed is 0 there and 1 here"),
        (body(), {}, "model.name is mlp there and body here"),
        (mlp(), {"lr": 0.5}, "optimizer.lr"),
    ],
)
def test_checkpoint_of_another_training_is_refused(
    model: Model, changes: dict[str, Any], named: str, tmp_path: Path
) -> None:
    mlp().fit(training(tmp_path, LOSSES))
    with pytest.raises(InputError, match=named):
        model.fit(training(tmp_path, LOSSES, **changes))


def test_damaged_checkpoint_is_named(tmp_path: Path) -> None:
    mlp().fit(training(tmp_path, LOSSES))
    path = tmp_path / "checkpoints/last.ckpt"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="last.ckpt is damaged"):
        mlp().fit(training(tmp_path, LOSSES))


def test_curvature_of_a_relu_network_is_said_to_be_lost(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        trained = mlp(activation="relu").fit(training(tmp_path, {"data": {}, "navier_cauchy": {}}))
    assert "second derivatives, which are zero everywhere in a network of ReLU" in caplog.text
    assert trained.record.history[0]["share/navier_cauchy"] == 0
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        mlp().fit(training(tmp_path / "smooth", LOSSES))
    assert "second derivatives" not in caplog.text


def test_no_loss_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to minimise"):
        mlp().fit(training(tmp_path, {}))


def test_gpu_that_is_not_there_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="finds no GPU"):
        mlp().fit(training(tmp_path, LOSSES, accelerator="gpu"))


def test_one_pressure_is_enough_to_train_on(tmp_path: Path) -> None:
    whole = training(tmp_path, LOSSES, validation=0.0)
    samples = replace(whole.samples, cases=Cases.path(np.full(len(TRAIN), 20.0)))
    assert np.isfinite(mlp().fit(replace(whole, samples=samples)).predict(samples.points_mm[:2], 20.0)).all()
