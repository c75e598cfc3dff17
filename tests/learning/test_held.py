"""Points that are set aside are seen by no fit, so that what is calibrated on them holds."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
import torch

from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import discover, names, plugin
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.neural import TrainedModel
from pgdl_lab.surrogate.calibration import FEWEST, bar_deviations, covering, covering_line, fits
from tests.trainings import TRAIN, small, training

discover()
TRAINED = [name for name in names("model") if issubclass(plugin("model", name), TrainedModel)]
QUICK: dict[str, dict[str, Any]] = {
    "body": {"depth": 1, "width": 16, "modes": 32, "degree": 2},
    "hybrid": {"degree": 3, "rounds": 1},
    "pod": {"degree": 4, "draws": 16},
}


def few(folder: Path, count: int, seed: int, **changes: Any) -> Training:
    """A training on `count` points."""
    chosen = np.random.default_rng(seed).choice(TRAIN, count, replace=False)
    return training(folder, {"data": {}}, samples=Samples.of(small(), chosen), seed=seed, **changes)


def covered(surrogate: Any) -> float:
    """Share of the errors at all points, few of which were trained on, that the error bars cover."""
    data = small()
    error = np.abs(surrogate.predict(data.domain.points_mm, data.pressures_kpa) - data.displacements)
    bars = surrogate.error_bar(data.domain.points_mm, data.pressures_kpa)
    return float((error <= bars[..., None]).mean())


def test_a_tenth_is_set_aside_and_nothing_lost(tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}})
    assert len(how.samples.pressures_kpa) == 1800 and len(how.held.pressures_kpa) == 200
    given = Samples.of(small(), TRAIN)
    ours, theirs = (
        np.column_stack([part.points_mm, part.pressures_kpa, part.displacements_mm]) for part in (how.whole, given)
    )
    assert np.array_equal(np.unique(ours, axis=0), np.unique(theirs, axis=0)) and len(ours) == len(theirs)
    other = training(tmp_path, {"data": {}}, seed=1)
    assert not np.array_equal(how.held.points_mm, other.held.points_mm)
    assert not len(training(tmp_path, {"data": {}}, validation=0.0).held.pressures_kpa)


@pytest.mark.parametrize("name", TRAINED)
def test_nothing_that_a_network_begins_with_depends_on_points_set_aside(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # of a finger that is not known; what guides it knows no data
    monkeypatch.setattr(
        "pgdl_lab.learning.guide.guide", lambda scene, *_: np.zeros((len(scene.domain.points_mm), 4, 2))
    )
    how = training(tmp_path, {"data": {}, "boundary": {}})
    wrong = replace(how.held, displacements_mm=1e3 + how.held.displacements_mm)
    begun = []
    for each in (how, replace(how, held=wrong)):
        torch.manual_seed(0)
        begun.append(plugin("model", name)(**QUICK.get(name, {})).begin(each))
    (field, samples), (other, others) = begun
    assert field.state_dict().keys() == other.state_dict().keys()
    for key, value in field.state_dict().items():
        assert torch.equal(value, other.state_dict()[key]), key
    assert np.array_equal(samples.displacements_mm, others.displacements_mm)
    assert len(samples.pressures_kpa) == len(how.samples.pressures_kpa)


@pytest.mark.parametrize("count", [4, 10, FEWEST, 60])
def test_what_covers_some_errors_covers_the_next_in_19_of_20_cases(count: int) -> None:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(4000):
        sizes = np.abs(rng.standard_normal((count + 1, 2)))
        found.append((sizes[-1] <= covering(sizes[:-1])).mean())
    assert 0.945 < np.mean(found) < 0.99


@pytest.mark.parametrize("twentieths", [1, 2, 5, 50])
def test_one_of_twenty_is_left_above_counted_with_the_next(twentieths: int) -> None:
    sizes = np.random.default_rng(0).permutation(20.0 * twentieths - np.arange(1, 20 * twentieths))
    found = covering(sizes[:, None]) * (1 + 1e-12)
    assert (sizes > found).sum() == twentieths - 1 and found < sizes.max() + 1e-9


@pytest.mark.parametrize("count", [1, 4, FEWEST - 1])
def test_few_are_taken_for_draws_of_unknown_size(count: int) -> None:
    sizes = np.tile([3.0, 4.0], (count, 1))  # their root mean square is 5 / √2
    assert covering(sizes) == pytest.approx(5 / np.sqrt(2) * scipy.stats.t(count).ppf(0.975))
    one = np.zeros((count, 2))
    one[0, 0] = 9.0
    assert covering(one) == pytest.approx(max(9.0, 9.0 / np.sqrt(2 * count) * scipy.stats.t(count).ppf(0.975)))


@pytest.mark.parametrize(("within", "beyond"), [(2.0, 3.0), (3.0, 2.0)])
def test_bars_beyond_are_calibrated_on_the_highest_pressures_of_a_fit_to_those_below(
    within: float, beyond: float
) -> None:
    kpa = np.random.default_rng(1).permutation(np.arange(1, 801) / 16)
    asked = []

    def ratios(held: Any, judged: Any) -> Any:
        asked.append((kpa[held], kpa[judged]))
        return np.full((judged.sum(), 2), within if len(asked) < fits(Cases.path(kpa)) else beyond)

    found = bar_deviations(Cases.path(kpa), ratios, np.random.default_rng(0))
    assert found is not None
    bar_kpa, deviations = found
    held, judged = asked[-1]
    assert np.array_equal(np.sort(held), np.arange(44 * 16 + 1, 801) / 16)  # the uppermost 12 %
    assert np.array_equal(np.sort(judged), np.arange(48 * 16, 801) / 16)  # of these the uppermost 4 %
    assert bar_kpa == pytest.approx([0.0, 50.0, 56.0])
    assert deviations == pytest.approx([within, within, max(within, beyond)])


def test_samples_of_one_pressure_tell_nothing_of_those_beyond() -> None:
    found = bar_deviations(
        Cases.path(np.full(30, 20.0)), lambda held, judged: np.full((judged.sum(), 2), 4.0), np.random.default_rng(0)
    )
    assert found is not None and found[1] == pytest.approx([4.0, 4.0, 4.0]) and found[0][1] == 20


@pytest.mark.parametrize("growth", [0.0, 1.0, -0.5])
def test_bars_follow_errors_that_outgrow_what_is_expected_of_them_as_the_pressure_rises(growth: float) -> None:
    rng = np.random.default_rng(2)
    kpa = rng.uniform(0, 50, 1000)
    size = 1 + growth * kpa / 50
    errors = size[:, None] * np.abs(rng.standard_normal((1000, 2)))
    found = bar_deviations(Cases.path(kpa), lambda held, judged: errors[judged], np.random.default_rng(0))
    assert found is not None
    line = np.interp(kpa, *found)[:, None]
    if growth < 0:  # none is told too narrow because a few happened to err less at the highest pressures
        assert found[1][0] == found[1][1] and (errors <= line).mean() > 0.93
        return
    assert found[1][:2] == pytest.approx([1.96, 1.96 * (1 + growth)], rel=0.25)
    for low, high in ((0, 15), (35, 50)):
        asked = (kpa > low) & (kpa < high)
        assert 0.9 < (errors[asked] <= line[asked]).mean() < 0.99


def test_errors_of_nothing_need_no_bars() -> None:
    assert not covering_line(np.linspace(0, 1, 30), np.zeros((30, 2))).any()


@pytest.mark.parametrize("name", ["body", "mlp", "hybrid", "gaussian_process"])
def test_fewer_points_than_tell_what_95_of_100_lie_below_have_no_bars(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    given = {**QUICK.get(name, {}), **({"guide": "none"} if name == "hybrid" else {})}
    surrogate = plugin("model", name)(**given).fit(few(tmp_path, FEWEST - 1, 0))
    assert surrogate.error_bar([[20.0, 5.0]], 20.0) is None
    told = "18 points are too few to tell how far the model errs, so it has no error bars: train on 19 points at least."
    assert told in caplog.text
    assert "without an error bar" in surrogate._told_bar(np.array([[20.0, 5.0]]), np.array([60.0]))


def test_of_few_samples_all_are_held_out_in_turn_and_of_many_a_tenth_is() -> None:
    for count, judged in ((19, 19), (40, 40), (300, 120), (1000, 100), (5000, 500)):
        seen = []

        def ratios(held: Any, asked: Any, seen: Any = seen) -> Any:
            seen.append(np.flatnonzero(held))
            return np.ones((asked.sum(), 2))

        cases = Cases.path(np.linspace(1, 50, count))
        bar_deviations(cases, ratios, np.random.default_rng(0))
        inside = np.concatenate(seen[:-1])
        assert len(seen) == fits(cases) and len(inside) == len(np.unique(inside)) == judged


@pytest.mark.parametrize("name", ["body", "pod", "finite_element", "gaussian_process"])
def test_bars_hold_for_few_points(name: str, tmp_path: Path) -> None:
    shares = []
    for seed in range(3):
        how = few(tmp_path / str(seed), 60, seed, max_epochs=5)
        shares.append(covered(plugin("model", name)(**QUICK.get(name, {})).fit(how)))
    assert np.mean(shares) > 0.88 and min(shares) > 0.75


def test_too_few_points_set_aside_and_no_time_for_more_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    model = plugin("model", "mlp")(depth=1, width=8)
    model.fit(few(tmp_path / "enough", 60, 0))
    assert "no error bars" not in caplog.text
    surrogate = model.fit(few(tmp_path / "short", 60, 0, max_time="0.5", max_epochs=10**6))
    assert "There was no time to train without parts of the points" in caplog.text
    assert surrogate.error_bar([[20.0, 5.0]], 20.0) is None
