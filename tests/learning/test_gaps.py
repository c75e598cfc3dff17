"""Stretches without training points: found, and error bars that hold in them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pgdl_lab
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.export import numpy_form
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.gaps import BLOCKS, FEWEST, Gap
from tests.trainings import TRAIN, small, training

discover()
NONE = np.zeros((0, 2))
QUICK: dict[str, dict[str, Any]] = {
    "pod": {"degree": 4, "rounds": 2, "draws": 16},
    "finite_element": {"degree": 4},
    "gaussian_process": {"points": 400},
    "mlp": {"depth": 1, "width": 16},
}


def without(low: float, high: float) -> np.ndarray:
    """Indices of training points, none of which lies between these parts of the length."""
    data = small()
    share = np.tile(data.domain.points_mm[:, 0] / data.domain.points_mm[:, 0].max(), len(data.pressures_kpa))[TRAIN]
    return TRAIN[(share < low) | (share >= high)][::3]


def line(*places: float) -> np.ndarray:
    return np.column_stack([places, np.zeros(len(places))])


def test_what_is_farther_than_usual_from_training_points_is_a_gap() -> None:
    body = line(*range(101))
    gap = Gap.left_by(np.delete(body, range(40, 60), axis=0), body, NONE)
    assert gap is not None and gap.usual_mm == 1 and np.flatnonzero(gap.far).tolist() == list(range(41, 59))
    assert gap.distance_mm.max() == 10
    assert Gap.left_by(body[::2], body, NONE) is None and Gap.left_by(body[:1], body, NONE) is None
    # what is held exactly is known
    assert Gap.left_by(body[20:], body, NONE) is not None and Gap.left_by(body[20:], body, body[:20]) is None


def test_stretches_are_left_out_that_are_as_deep_as_the_gap() -> None:
    body = line(*range(101))
    samples = np.delete(body, range(40, 60), axis=0)
    gap = Gap.left_by(samples, body, NONE)
    assert gap is not None
    blocks = list(gap.blocks(samples))
    assert FEWEST <= len(blocks) <= BLOCKS
    for held, judged in blocks:
        assert 0 < held.mean() <= 0.5 and (judged <= held).all()
        far = np.abs(samples[judged, None, 0] - samples[None, ~held, 0]).min(axis=1)
        assert far.min() > gap.usual_mm and far.max() <= gap.distance_mm.max()


def test_bars_grow_in_a_gap_by_what_covers_the_errors_of_stretches_left_out() -> None:
    body = line(*range(101))
    samples = np.delete(body, range(40, 60), axis=0)
    gap = Gap.left_by(samples, body, NONE)
    assert gap is not None
    wider = gap.stretch(samples, lambda held, judged: np.full((judged.sum(), 2), 3.0))
    assert wider is not None and set(wider[~gap.far]) == {1.0} and (wider[gap.far] > 3.0).all()
    narrower = gap.stretch(samples, lambda held, judged: np.full((judged.sum(), 2), 1e-3))
    assert narrower is not None and set(narrower) == {1.0}


def test_too_little_beside_a_gap_tells_nothing_of_it(caplog: pytest.LogCaptureFixture) -> None:
    body = line(*range(101))
    gap = Gap.left_by(body[:30], body, NONE)
    assert gap is not None
    assert gap.stretch(body[:4], lambda held, judged: np.ones((judged.sum(), 2))) is None
    assert "No training point lies within 71 mm of x = 100, z = 0 mm, and too few lie elsewhere" in caplog.text


@pytest.fixture
def thrice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors in stretches that are left out are three times their bars."""
    monkeypatch.setattr(Gap, "stretch", lambda gap, samples_mm, excess: np.where(gap.far, 3.0, 1.0))


@pytest.mark.parametrize("name", QUICK)
@pytest.mark.usefixtures("thrice")
def test_bars_are_wider_in_the_gap_alone_and_so_from_every_file(name: str, tmp_path: Path) -> None:
    data, low, high = small(), 0.4, 0.65
    how = training(tmp_path, {"data": {}}, samples=Samples.of(data, without(low, high)), max_epochs=2)
    model = plugin("model", name)(**QUICK[name])
    surrogate = model.fit(how)
    bars = surrogate.error_bar(data.domain.points_mm, data.pressures_kpa)
    state = {key: array for key, array in surrogate.state().items() if not key.endswith("stretch")}
    assert bars is not None and len(state) == len(surrogate.state()) - 1
    wider = bars / model.restore(state, surrogate.record).error_bar(data.domain.points_mm, data.pressures_kpa)
    share = data.domain.points_mm[:, 0] / data.domain.points_mm[:, 0].max()
    assert wider[:, (share > low + 0.05) & (share < high - 0.05)] == pytest.approx(3.0)
    assert np.median(wider[:, (share < low) | (share > high)], axis=1) == pytest.approx(1.0)
    surrogate.save(tmp_path / "surrogate.pt")
    again = pgdl_lab.load(tmp_path / "surrogate.pt")
    assert np.array_equal(again.error_bar(data.domain.points_mm, data.pressures_kpa), bars)
    numpy_form.write(surrogate, tmp_path / "surrogate.npz")
    plain = pgdl_lab.load(tmp_path / "surrogate.npz").error_bar(data.domain.points_mm, data.pressures_kpa)
    assert plain == pytest.approx(bars, rel=1e-3)


@pytest.mark.usefixtures("thrice")
def test_a_stretch_of_another_body_is_refused(tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}}, samples=Samples.of(small(), without(0.4, 0.65)), max_epochs=2)
    surrogate: Any = plugin("model", "mlp")(**QUICK["mlp"]).fit(how)
    assert surrogate.last_layer.stretch is not None
    surrogate.last_layer = replace(surrogate.last_layer, stretch=np.ones(3))
    surrogate.save(tmp_path / "surrogate.pt")
    with pytest.raises(InputError, match="does not hold the weights"):
        pgdl_lab.load(tmp_path / "surrogate.pt")


@pytest.mark.parametrize(("name", "count", "words"), [
    ("pod", 4, "4 training points do not determine a polynomial of degree 10 .*: train on 11 points at least, or set"),
    ("finite_element", 7, "train on 8 points at least, or set model.degree=6"),
])  # fmt: skip
def test_a_fit_that_is_not_determined_is_refused(name: str, count: int, words: str, tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}}, samples=Samples.of(small(), TRAIN[::200][:count]))
    with pytest.raises(InputError, match=words):
        plugin("model", name)().fit(how)
