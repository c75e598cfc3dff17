"""What models are trained on, and how those of few points are judged, by hand."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core.domain import NONE, Domain
from pgdl_lab.learning import left_out
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.left_out import FEW, PARTS, bars_left_out, scores_left_out
from pgdl_lab.learning.module import TrainingDiverged
from pgdl_lab.learning.scene import Scene
from tests.fingers import pneunet
from tests.trainings import TRAIN, small, training


def test_samples_are_points_of_snapshots() -> None:
    data = small()
    nodes = len(data.domain.points_mm)
    chosen = np.array([3 * nodes + 7, 0, 19 * nodes + nodes - 1])
    samples = Samples.of(data, chosen)
    for i, (snapshot, node) in enumerate([(3, 7), (0, 0), (19, nodes - 1)]):
        assert np.array_equal(samples.points_mm[i], data.domain.points_mm[node])
        assert samples.pressures_kpa[i] == data.pressures_kpa[snapshot]
        assert np.array_equal(samples.displacements_mm[i], data.displacements[snapshot, node])
    assert samples.ranges()["pressure_kpa"] == [2.5, 50.0]
    x, z = samples.points_mm.T
    assert samples.ranges()["x_mm"] == [x.min(), x.max()] and samples.ranges()["z_mm"] == [z.min(), z.max()]
    both = samples.at(np.array([2])).joined(samples.at(np.array([True, False, False])))
    assert np.array_equal(both.pressures_kpa, [50.0, data.pressures_kpa[3]])
    assert np.array_equal(both.displacements_mm, samples.displacements_mm[[2, 0]])


def test_the_scene_of_a_finger_weighs_what_the_finger_does() -> None:
    data, finger = small(), pneunet(gravity_m_s2=[1.0, 2.0, -9.0])
    scene = Scene.of(finger, data)
    assert scene.max_kpa == 50 and scene.finger is finger and scene.domain.base is data.domain.base
    assert np.array(scene.body_force_n_mm3) == pytest.approx(finger.body_force_n_mm3[[0, 2]])
    assert scene.body_force_n_mm3[1] == pytest.approx(-9 * scene.body_force_n_mm3[0]) and scene.body_force_n_mm3[0] > 0
    assert scene.kept_domain is not None and replace(scene, domain=replace(scene.domain, base=NONE)).kept_domain is None


@pytest.mark.parametrize("flipped", [False, True])
def test_the_outline_of_a_square_looks_outwards(flipped: bool) -> None:
    points = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 2.0], [4.0, 2.0]])
    triangles = np.array([[0, 1, 3], [0, 3, 2]])[:, :: -1 if flipped else 1]
    scene = Scene(Domain(points, triangles, clamp=np.array([0, 2])), 50.0, 10.0, 0.5, (0.0, 0.0))
    found = {tuple(middle): tuple(normal) for middle, normal in zip(*scene.outline, strict=True)}
    assert found == {(2.0, 0.0): (0.0, -1.0), (2.0, 2.0): (0.0, 1.0), (4.0, 1.0): (1.0, 0.0)}


def few(folder: Path, count: int, **changes: Any) -> Training:
    return training(folder, {"data": {}}, samples=Samples.of(small(), TRAIN[:count]), **changes)


def test_each_point_is_judged_by_the_network_that_was_trained_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Training, Samples]] = []
    monkeypatch.setattr(left_out, "ridge_of", lambda field, samples: float(len(samples.pressures_kpa)))
    monkeypatch.setattr(left_out, "trained_field", lambda model, without: without)

    def scores(without: Training, trained: Samples, out: Samples, rho: float) -> Any:
        assert trained is without.samples and rho == len(how.samples.pressures_kpa)
        asked.append((without, out))
        return out.displacements_mm

    monkeypatch.setattr(left_out, "scores_mm", scores)
    model: Any = None
    for count in (2 * PARTS, 53, FEW - 1):
        asked.clear()
        how = few(tmp_path, count, seed=3)
        found = scores_left_out(model, how, None, tmp_path)
        assert np.array_equal(np.asarray(found), how.whole.displacements_mm)  # each at its own place
        assert len(asked) == PARTS and len({without.folder for without, _ in asked}) == PARTS
        for without, out in asked:
            assert len(out.pressures_kpa) in (count // PARTS, count // PARTS + 1) and without.seed == 3
            rows = [np.column_stack([part.points_mm, part.pressures_kpa]) for part in (without.whole, out, how.whole)]
            assert len(rows[0]) + len(rows[1]) == count
            assert np.array_equal(np.unique(np.concatenate(rows[:2]), axis=0), np.unique(rows[2], axis=0))


def test_networks_that_cannot_be_trained_without_a_part_have_no_bars(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    model: Any = None
    field: Any = None
    how = few(tmp_path, 50, max_time="60")
    monkeypatch.setattr(left_out.Gap, "left_by", lambda *_: None)
    monkeypatch.setattr(left_out, "ridge_of", lambda *_: 1.0)
    monkeypatch.setattr(left_out, "trained_field", lambda *_: None)
    monkeypatch.setattr(left_out, "scores_mm", lambda *given: np.full((len(given[2].pressures_kpa), 2), np.nan))
    assert bars_left_out(model, how, field, 0.0) is None and not caplog.text
    assert bars_left_out(model, how, field, 60.1 / (PARTS + 1)) is None
    assert "190 points or more" in caplog.text and "give trainer.max_time 66 s" in caplog.text

    def diverges(*_: Any) -> Any:
        raise TrainingDiverged("gone")

    monkeypatch.setattr(left_out, "trained_field", diverges)
    assert bars_left_out(model, how, field, 0.0) is None
