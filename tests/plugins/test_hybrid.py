from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.errors import InputError
from pgdl_lab.learning.data import Training
from pgdl_lab.registry import discover, plugin
from tests.trainings import small, training

discover()
QUICK: dict[str, Any] = {"degree": 3, "inputs": 3, "rounds": 1, "folds": 2, "width": 8}


def hybrid(**fields: Any) -> Any:
    return plugin("model", "hybrid")(**{**QUICK, **fields})


def all_shown(folder: Path) -> Training:
    """A training of which no point is set aside."""
    return training(folder, {"data": {}}, validation=0.0)


def finished(field: Any, record: Any) -> Any:
    return hybrid().finished(field, record, all_shown(Path()))


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return hybrid().begin(all_shown(tmp_path_factory.mktemp("hybrid")))


def test_starts_as_the_closed_form(tmp_path: Path, begun: Any) -> None:
    whole, data = all_shown(tmp_path), small()
    closed = plugin("model", "pod")(degree=3, rounds=1).fit(whole)
    surrogate = finished(begun[0], closed.record)
    points, kpa = data.points[::7], np.array([0.0, 10.0, 50.0])
    assert surrogate.predict(points, kpa) == pytest.approx(closed.predict(points, kpa), abs=1e-9)
    assert surrogate.error_bar(points, kpa) == pytest.approx(closed.error_bar(points, kpa), rel=1e-4)


def test_is_shown_errors_at_points_it_was_not_fitted_to(tmp_path: Path, begun: Any) -> None:
    field, shown = begun
    whole = all_shown(tmp_path)
    surrogate = finished(field, plugin("model", "pod")(degree=3, rounds=0).fit(whole).record)
    samples = whole.samples
    here = np.stack([
        surrogate.predict(point[None], kpa)[0]
        for point, kpa in zip(samples.points_mm[:300], samples.pressures_kpa[:300], strict=True)
    ])  # fmt: skip
    own = ((samples.displacements_mm[:300] - here) ** 2).mean()
    unseen = ((shown.displacements_mm[:300] - here) ** 2).mean()
    assert unseen > 2 * own


def test_trained_field_and_its_nodal_form_agree_and_hold_the_clamp(begun: Any) -> None:
    field, data = begun[0], small()
    torch.manual_seed(0)
    with torch.no_grad():
        kept = [weight.clone() for weight in field.parameters()]
        for weight in field.parameters():
            torch.nn.init.normal_(weight)
        kpa = torch.tensor([0.0, 20.0, 60.0], dtype=torch.double)
        whole = field.displacements(field.coordinates(data.points, 0), kpa).numpy()
        nodal = finished(field, None).probe(data.points).values(kpa.numpy())
        for weight, value in zip(field.parameters(), kept, strict=True):
            weight.copy_(value)
        start = field.displacements(field.coordinates(data.points, 0), kpa).numpy()
    assert np.abs(whole - start).max() > 1e-3
    assert nodal == pytest.approx(whole, abs=1e-9)
    assert np.abs(whole[:, data.clamp]).max() < 1e-12  # rounding of products of different sizes


def test_training_never_ends_worse_than_the_closed_form_on_the_points_set_aside(tmp_path: Path) -> None:
    whole = training(tmp_path, {"data": {}, "navier_cauchy": {"weight": 1e3}}, max_epochs=3, lr=0.3)
    surrogate = hybrid().fit(whole)
    history = surrogate.record.history
    assert history[-1]["raw/navier_cauchy"] > 0
    closed = plugin("model", "pod")(degree=3, rounds=1).fit(training(tmp_path, {"data": {}}))
    data = small()
    ours, theirs = (
        ((each.predict(data.points, data.pressures_kpa) - data.displacements) ** 2).mean()
        for each in (surrogate, closed)
    )
    assert ours <= 1.05 * theirs


def test_a_network_that_gains_nothing_leaves_the_closed_form_of_all_points(tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}}, max_epochs=1, lr=10.0, validation=0.3)
    ours, data = hybrid().fit(how), small()
    whole = plugin("model", "pod")(degree=3, rounds=1).fit(all_shown(tmp_path))
    part = plugin("model", "pod")(degree=3, rounds=1).fit(replace(how, held=how.held.at(np.arange(0))))
    point = (data.points, 30.0)
    off, near = (np.abs(ours.predict(*point) - other.predict(*point)).mean() for other in (part, whole))
    assert near < off / 3


def test_its_closed_form_needs_data(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"model=hybrid is fitted to the data, and loss=\[boundary\] does not count"):
        hybrid().fit(training(tmp_path, {"boundary": {}}))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"inputs": 5}, "model.inputs is 5; the closed form has 1 to 4 modes"),
        ({"correction_degree": 4}, "model.correction_degree is 4"),
        ({"degree": 60}, "model.degree is 60; it must be below 48"),
        ({"folds": 1}, "model.folds is 1; it must be at least 2"),
        ({"dtype": "float32"}, "model.dtype of hybrid is float64"),
        ({"patience": 0}, "model.patience is 0"),
    ],
)
def test_settings_are_checked(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        hybrid(**fields)
