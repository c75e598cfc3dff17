import copy
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pgdl_lab
from pgdl_lab.core.domain import NONE
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import plugin
from pgdl_lab.surrogate.limits import Outside, TooFar
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.surrogates import MODELS, trained
from tests.trainings import small, training


@pytest.fixture(scope="module", params=MODELS)
def surrogate(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    return trained(request.param, tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def linear(tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    return trained("pod", tmp_path_factory.mktemp("run"))


def test_one_pressure_gives_n_by_2_and_several_p_by_n_by_2(surrogate: Surrogate) -> None:
    points = small().domain.points_mm
    several = surrogate.predict(points, [10.0, 20.0, 50.0])
    assert several.shape == (3, len(points), 2) and several.dtype == np.float64
    assert surrogate.predict(points, 20) == pytest.approx(several[1], abs=1e-4)
    assert surrogate.predict(points[3:4], 20.0) == pytest.approx(several[1, 3:4], abs=1e-4)
    assert surrogate.at(points[3:4])(20.0) == pytest.approx(several[1, 3:4], abs=1e-4)


def test_no_points_and_no_pressures_give_empty_fields(surrogate: Surrogate) -> None:
    points = small().domain.points_mm
    assert surrogate.predict(points, []).shape == (0, len(points), 2)
    assert surrogate.predict(np.empty((0, 2)), 10.0).shape == (0, 2)
    assert surrogate.predict(np.empty((0, 2)), [10.0, 20.0]).shape == (2, 0, 2)


def test_slopes_are_those_of_the_field(surrogate: Surrogate) -> None:
    at = surrogate.at(small().domain.points_mm[::50])
    assert at.slope(20.0) == pytest.approx((at(20.5) - at(19.5)), rel=2e-2, abs=1e-3)


def test_error_bars_have_the_shape_of_the_question(surrogate: Surrogate) -> None:
    points = small().domain.points_mm
    several = surrogate.error_bar(points, [10.0, 60.0])
    assert several is not None
    assert several.shape == (2, len(points)) and (several > 0).all()
    assert surrogate.error_bar(points[:3], 60) == pytest.approx(several[1, :3])
    with pytest.raises(InputError, match="points_mm has shape"):
        surrogate.error_bar(points[0], 10.0)


def test_one_line_tells_model_finger_pressures_and_error(surrogate: Surrogate) -> None:
    known = copy.copy(surrogate)
    of = {"finger": {"name": "pneunet", "wall_mm": 3.0}, "surrogate_error": {"rms_mm": 0.00123, "largest_mm": 0.1}}
    known.record = replace(surrogate.record, provenance=of)
    name, low = surrogate.model["name"], surrogate.ranges["pressure_kpa"][0]
    told = f"<surrogate {name} of finger pneunet: {low:g} to 50 kPa"
    assert repr(known) == f"{told}, 0.0012 mm RMS off at points not trained on>"
    known.record = replace(known.record, provenance={"finger": of["finger"]})
    assert repr(known) == f"{told}>"


def test_knows_units_ranges_and_its_tip(surrogate: Surrogate) -> None:
    assert surrogate.units == {"points": "mm", "pressure": "kPa", "displacement": "mm"}
    assert surrogate.ranges["pressure_kpa"] == [2.5, 50.0]
    assert surrogate.tip_mm == pytest.approx([114.0, 0.0])


@pytest.mark.parametrize(
    ("points", "kpa", "words"),
    [
        ([1.0, 2.0], 10.0, r"points_mm has shape \(2,\)"),
        ([], 10.0, r"points_mm has shape \(0,\)"),
        ([[1.0, 2.0, 3.0]], 10.0, r"points_mm has shape \(1, 3\)"),
        ([[[1.0, 2.0]]], 10.0, r"points_mm has shape \(1, 1, 2\)"),
        ([[1.0, float("nan")]], 10.0, "points_mm holds 1 values that are not finite"),
        ([[1.0, 2.0]], float("inf"), "pressure_kpa holds 1 values"),
        ([[1.0, 2.0]], [[1.0]], r"pressure_kpa has shape \(1, 1\)"),
        ([["a", "b"]], 1.0, "points_mm cannot be read as numbers"),
        ([[1.0, 2.0]], None, "pressure_kpa cannot be read as numbers"),
        ([[1.0, 2.0]], "30 kPa", "pressure_kpa cannot be read as numbers"),
        ([[1.0, 2.0]], 1j, "pressure_kpa cannot be read as numbers"),
        ([[1.0], [1.0, 2.0]], 1.0, "points_mm cannot be read as numbers"),
    ],
)
def test_bad_input_is_named(surrogate: Surrogate, points: Any, kpa: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        surrogate.predict(points, kpa)


@pytest.mark.parametrize("kpa", [float("nan"), "x", None, [1.0, 2.0]])
def test_bad_pressures_of_a_loop_are_named(linear: Surrogate, kpa: Any) -> None:
    with pytest.raises(InputError, match="pressure_kpa"):
        linear.at([[5.0, 5.0]])(kpa)


def test_any_shape_is_answered_or_refused_in_a_sentence(linear: Surrogate) -> None:
    rng = np.random.default_rng(0)
    linear.outside = "ignore"
    for _ in range(300):
        points_shape, kpa_shape = (tuple(rng.integers(0, 4, rng.integers(0, 4))) for _ in range(2))
        kinds = [float, np.float32, int, bool, complex, object, "U8"]
        points = np.array(114 * rng.random(points_shape)).astype(kinds[rng.integers(len(kinds))])
        kpa = np.array(50 * rng.random(kpa_shape)).astype(kinds[rng.integers(len(kinds))])
        try:
            field = linear.predict(points, kpa)
        except InputError as refused:
            assert "\n" not in str(refused)
            numeric = points.dtype.kind in "fi" and kpa.dtype.kind in "fi"
            assert not (numeric and points.ndim == 2 and points.shape[1] == 2 and kpa.ndim < 2)
        else:
            assert field.shape == (*kpa.shape, *points.shape)
            assert np.isfinite(field).all()
    linear.outside = "warn"


def test_pressures_and_points_outside_are_told_once_with_the_error_bar(linear: Surrogate, tmp_path: Path) -> None:
    linear.save(tmp_path / "surrogate.pt")
    fresh = pgdl_lab.load(tmp_path / "surrogate.pt")
    with pytest.warns(Outside, match=r"60 kPa lies outside the trained 2.5 to 50 kPa: .* bar of up to .* mm\.$"):
        beyond = fresh.predict([[114.0, 0.0]], 60.0)
    with pytest.warns(Outside, match=r"1 of 1 points lie off the .* x = 11, z = 15 mm by 0\.5 mm: .* error bar"):
        fresh.predict([[11.0, 15.0]], 10.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(fresh.predict([[114.0, 0.0]], 60.0), beyond)
        assert np.array_equal(fresh.at([[114.0, 0.0]])(60.0), beyond)
        assert fresh.predict([[11.0, 16.0]], 10.0) == pytest.approx(fresh.predict([[10.5, 16.0]], 10.0))
        linear.predict(
            small().domain.points_mm, [0.0, 50.0]
        )  # the pressures from 0 up to the first snapshot count as trained


def test_what_is_said_of_points_off_the_body_is_so(surrogate: Surrogate, tmp_path: Path) -> None:
    surrogate.save(tmp_path / "surrogate.pt")
    fresh = pgdl_lab.load(tmp_path / "surrogate.pt")
    with pytest.warns(Outside) as told:
        there = fresh.predict([[11.0, 16.0]], 10.0)
    same = there == pytest.approx(fresh.predict([[10.5, 16.0]], 10.0), abs=1e-9)
    assert same == ("counts as the nearest point on it" in str(told[0].message)) == fresh.knows_body
    assert same != ("is answered where it lies" in str(told[0].message))


def test_pressures_and_points_outside_can_be_refused(surrogate: Surrogate, tmp_path: Path) -> None:
    surrogate.save(tmp_path / "surrogate.pt")
    strict = pgdl_lab.load(tmp_path / "surrogate.pt", outside="raise")
    with pytest.raises(InputError, match="60 kPa lies outside the trained 2.5 to 50 kPa: give pressures in kPa"):
        strict.predict([[114.0, 0.0]], 60.0)
    with pytest.raises(InputError, match="51 kPa lies outside"):
        strict.at([[114.0, 0.0]])(51.0)
    with pytest.raises(InputError, match="points lie off the undeformed body, such as x = 0.114, z = 20 mm"):
        strict.predict([[0.114, 20.0]], 10.0)
    with pytest.raises(InputError, match="outside is 'shout'"):
        pgdl_lab.load(tmp_path / "surrogate.pt", outside="shout")


@pytest.mark.parametrize("kpa", [30000.0, [10.0, 62.6], -0.1])
def test_pressures_far_outside_are_refused_whatever_is_said_of_those_near(surrogate: Surrogate, kpa: Any) -> None:
    refused = r"kPa lies too far outside the trained 2.5 to 50 kPa .*: give pressures in kPa from 0 to 62.5, train on"
    points = [[114.0, 0.0]]
    before, surrogate.outside = surrogate.outside, "ignore"
    try:
        for ask in (surrogate.predict, surrogate.error_bar):
            with pytest.raises(TooFar, match=refused):
                ask(points, kpa)
        worst = float(np.max(kpa))
        with pytest.raises(TooFar, match=refused):
            surrogate.at(points)(worst)
        answer = surrogate.predict(points, kpa, beyond=True)
        assert np.isfinite(answer).all()
        assert np.isfinite(surrogate.at(points, beyond=True)(worst)).all()
        assert surrogate.error_bar(points, kpa, beyond=True) is not None
        surrogate.predict(points, [0.0, 62.5])
    finally:
        surrogate.outside = before


def test_rounding_over_the_edge_is_no_question_outside(linear: Surrogate, tmp_path: Path) -> None:
    linear.save(tmp_path / "surrogate.pt")
    strict = pgdl_lab.load(tmp_path / "surrogate.pt", outside="raise")
    over = float(np.float32(0.1) * np.float32(500.0))  # single precision, as controllers have it
    for kpa in (over + 2e-5, -1e-5, np.nextafter(50.0, 51.0)):
        strict.predict([[114.0, 0.0]], kpa)
        strict.at([[114.0, 0.0]])(kpa)


@pytest.mark.parametrize("outside", ["warn", "ignore"])
def test_once_told_a_question_outside_costs_no_more_than_another(
    linear: Surrogate, tmp_path: Path, outside: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What costs is to look for the nearest point and for the error bar, for a sentence that nobody is shown."""
    linear.save(tmp_path / "surrogate.pt")
    fresh = pgdl_lab.load(tmp_path / "surrogate.pt", outside=outside)
    asked = fresh.at([[114.0, 0.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fresh.predict([[11.0, 16.0]], 60.0)

    def looked(*_: Any) -> Any:
        raise AssertionError("looked again")

    monkeypatch.setattr(type(fresh), "bars", looked)
    monkeypatch.setattr(type(fresh.domain.mesh), "distance_mm", looked)
    for _ in range(2):
        asked(60.0)
        fresh.predict([[114.0, 0.0]], 60.0)
        fresh.predict([[11.0, 17.0]], 10.0)


def test_threads_share_a_surrogate(surrogate: Surrogate) -> None:
    points = small().domain.points_mm
    parts = [points[start::7] for start in range(7)]
    alone = [surrogate.predict(part, 20.0) for part in parts]
    with ThreadPoolExecutor(8) as threads:
        together = list(threads.map(lambda turn: surrogate.predict(parts[turn % 7], 20.0), range(210)))
    assert all(np.array_equal(field, alone[turn % 7]) for turn, field in enumerate(together))


def test_threads_are_warned_once(linear: Surrogate, tmp_path: Path) -> None:
    linear.save(tmp_path / "surrogate.pt")
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with warnings.catch_warnings(record=True) as told, ThreadPoolExecutor(8) as threads:
            warnings.simplefilter("always")
            for _ in range(50):
                fresh = pgdl_lab.load(tmp_path / "surrogate.pt")
                at, start = fresh.at([[114.0, 0.0]]), threading.Barrier(8)
                list(threads.map(lambda _, at=at, start=start: (start.wait(), at(60.0)), range(8)))
    finally:
        sys.setswitchinterval(interval)
    assert len(told) == 50


def test_a_surrogate_without_a_face_says_so(linear: Surrogate, tmp_path: Path) -> None:
    model = plugin("model", "finite_element")(degree=3)
    whole = training(tmp_path, {"data": {}})
    faceless = model.fit(replace(whole, scene=replace(whole.scene, domain=replace(whole.scene.domain, base=NONE))))
    faceless.save(tmp_path / "surrogate.pt")
    with pytest.raises(InputError, match="knows no face"):
        pgdl_lab.load(tmp_path / "surrogate.pt").pressure_for(curvature=3.0)
