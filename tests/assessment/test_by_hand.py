"""Latencies on a clock that is turned by hand, and the curvature of both base lines."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.assessment import latency
from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.core.dataset_file import DISPLACEMENT
from pgdl_lab.surrogate.curvature import mean_curvature_per_m
from tests.trainings import small


class Watched:
    """Predictions of which the first takes a minute, and then the k-th `milliseconds(k)`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, milliseconds: Any) -> None:
        self.now_s, self.calls, self.milliseconds = 0.0, 0, milliseconds
        self.seen: set[tuple[int, float, int]] = set()
        monkeypatch.setattr(latency, "time", SimpleNamespace(perf_counter=lambda: self.now_s))

    def predict(self, points: np.ndarray, kpa: float, *, beyond: bool) -> None:
        assert kpa == 7.0 and beyond  # at the highest pressure, whether it was trained on or not
        self.seen.add((len(points), float(points[0, 0]), torch.get_num_threads()))
        self()

    def __call__(self) -> None:
        self.now_s += 60.0 if self.calls == 0 else 1e-3 * self.milliseconds(self.calls)
        self.calls += 1


def test_percentiles_are_of_a_hundred_calls_that_take_long(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch, lambda call: 10.0 * call)
    found = latency._percentiles(watched)
    assert watched.calls == 101
    assert found == pytest.approx({"median": 505.0, "p99": 990.1})  # of 10, 20 … 1000 ms


def test_calls_that_take_little_are_repeated_for_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch, lambda _: 0.5)
    found = latency._percentiles(watched)
    assert watched.calls == pytest.approx(1001, abs=2) and found["median"] == pytest.approx(0.5)


def test_the_field_and_the_tip_are_asked_on_one_thread_and_on_all(monkeypatch: pytest.MonkeyPatch) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        watched: Any = Watched(monkeypatch, lambda _: 100.0)
        points = np.arange(10.0).reshape(5, 2)
        found = latency.latency_ms(watched, points, 3, 7.0)
        assert watched.seen == {(5, 0.0, 1), (1, 6.0, 1), (5, 0.0, 2), (1, 6.0, 2)}
        assert found["all_threads"]["threads"] == 2 and found["tip"]["median"] == pytest.approx(100)
        watched.seen.clear()
        assert latency.median_ms(lambda: watched.predict(points, 7.0, beyond=True)) == pytest.approx(100)
        assert watched.seen == {(5, 0.0, 1)}
    finally:
        torch.set_num_threads(before)


def test_curvatures_are_those_of_simulation_and_surrogate() -> None:
    """A base line bent to arcs of 50 mm and of 200 mm, the second downwards, of the same length."""
    data = small()
    length = np.linalg.norm(np.diff(data.domain.points_mm[data.domain.base], axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(length)])

    def bent(radius_mm: float) -> np.ndarray:
        turn = arc / radius_mm
        line = radius_mm * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1)
        moved = np.zeros_like(data.displacements)
        moved[:, data.domain.base] = line - data.domain.points_mm[data.domain.base]
        return moved

    upwards, downwards = bent(50.0), bent(-200.0)
    rows = Comparison(replace(data, fields={DISPLACEMENT: upwards}), downwards, np.arange(3)).curvature()
    assert [row["kpa"] for row in rows] == data.pressures_kpa.tolist()
    # the points are chords of the arcs, up to 2.5 mm long
    assert rows[4]["fem_per_m"] == pytest.approx(20.0, rel=1e-3)
    assert rows[4]["surrogate_per_m"] == pytest.approx(-5.0, rel=1e-3)
    apart = np.linalg.norm((upwards - downwards)[0, data.domain.base], axis=1)
    assert rows[4]["rms_distance_mm"] == pytest.approx(np.sqrt((apart**2).mean()))


def test_curvature_is_the_turning_by_the_length_however_a_line_lies_and_bends() -> None:
    """A line that leaves at 0.7 rad and whose curvature falls evenly from 30 to 10 per metre over 60 mm."""
    s = np.linspace(0, 60, 6001)
    angle = 0.7 + 0.03 * s - 0.02 * s**2 / 120
    step = np.diff(s)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)[1:]
    line = np.concatenate([[[5.0, -3.0]], [5.0, -3.0] + np.cumsum(step, axis=0)])
    assert mean_curvature_per_m(line[::100]) == pytest.approx(20.0, rel=1e-3)
    # six points tell no more than a polynomial of degree 5
    assert mean_curvature_per_m(line[::1200]) == pytest.approx(20.0, rel=2e-2)
