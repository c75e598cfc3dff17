"""Pressures for a tip or a curvature that is known."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import plugin
from pgdl_lab.surrogate.curvature import mean_curvature_per_m
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.synthetic import bend
from tests.trainings import training


@pytest.fixture(scope="module")
def surrogate(tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    folder: Path = tmp_path_factory.mktemp("run")
    model = plugin("model", "finite_element")(degree=6)
    fitted: Surrogate = model.fit(training(folder, {"data": {}}))
    return fitted


@pytest.mark.parametrize("kpa", [0.0, 0.1, 7.3, 31.4, 50.0])
def test_the_pressure_of_a_tip_is_found(surrogate: Surrogate, kpa: float) -> None:
    tip = surrogate.tip_mm + surrogate.at([surrogate.tip_mm])(kpa)[0]
    answer = surrogate.pressure_for(tip=tip)
    assert answer.reached and answer.distance < 1e-6
    assert float(answer) == pytest.approx(kpa, abs=1e-7)
    height = surrogate.pressure_for(tip=(None, tip[1]))  # may be reached at a lower pressure too
    assert height.reached and height.kpa <= kpa + 1e-7 and height.distance < 1e-6
    assert "reaches the target" in str(answer)


@pytest.mark.parametrize("kpa", [0.0, 12.0, 50.0])
def test_the_pressure_of_a_curvature_is_found(surrogate: Surrogate, kpa: float) -> None:
    domain = surrogate.domain
    line = domain.points_mm[domain.base]
    curvature = mean_curvature_per_m(line + surrogate.at(line)(kpa))
    answer = surrogate.pressure_for(curvature=curvature)
    assert answer.reached and answer.kpa == pytest.approx(kpa, abs=1e-5)


def test_a_model_is_close_to_what_it_learnt_from(surrogate: Surrogate) -> None:
    tip = surrogate.tip_mm + bend(surrogate.tip_mm[None], 33.3)[0]
    assert surrogate.pressure_for(tip=tip).kpa == pytest.approx(33.3, abs=0.01)


def test_out_of_reach_says_so_and_gives_the_nearest(surrogate: Surrogate) -> None:
    at = surrogate.at([surrogate.tip_mm])
    along = at.slope(20.0)[0] / np.linalg.norm(at.slope(20.0)[0])
    beside = surrogate.tip_mm + at(20.0)[0] + 3.0 * np.array([-along[1], along[0]])
    answer = surrogate.pressure_for(tip=beside)
    assert not answer.reached
    assert answer.distance == pytest.approx(3.0, abs=1e-6) and answer.kpa == pytest.approx(20.0, abs=1e-3)
    assert str(answer) == "The target is out of reach: 20 kPa comes nearest, 3 mm off."
    assert surrogate.pressure_for(tip=beside, tolerance=3.1).reached


def test_beyond_full_pressure_the_nearest_is_full_pressure(surrogate: Surrogate) -> None:
    at = surrogate.at([surrogate.tip_mm])
    answer = surrogate.pressure_for(tip=surrogate.tip_mm + at(50.0)[0] + 10 * at.slope(50.0)[0])
    assert not answer.reached and answer.kpa == 50.0
    assert surrogate.pressure_for(curvature=1000.0).kpa in (0.0, 50.0)


def test_of_several_pressures_the_nearest_counts(surrogate: Surrogate) -> None:
    grid = np.linspace(0, 50, 20001)
    places = surrogate.tip_mm + surrogate.predict([surrogate.tip_mm], grid)[:, 0]
    rng = np.random.default_rng(0)
    for target in rng.uniform(places.min(axis=0) - 30, places.max(axis=0) + 30, (60, 2)):
        best = np.linalg.norm(places - target, axis=1).min()
        assert surrogate.pressure_for(tip=target).distance <= best + 1e-9


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ({}, "takes one target"),
        ({"tip": (100.0, 0.0), "curvature": 1.0}, "takes one target"),
        ({"tip": (float("nan"), 0.0)}, "must be finite numbers"),
        ({"tip": (None, None)}, "must be finite numbers"),
        ({"tip": (1.0, 2.0, 3.0)}, "must be finite numbers"),
        ({"tip": "left"}, "must be finite numbers"),
        ({"tip": 5.0}, "must be finite numbers"),
        ({"tip": (5.0,)}, "must be finite numbers"),
        ({"curvature": float("inf")}, "must be finite numbers"),
        ({"curvature": 1.0, "tolerance": -1.0}, "tolerance is -1.0 1/m; it must not be negative"),
    ],
)
def test_bad_targets_are_named(surrogate: Surrogate, target: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        surrogate.pressure_for(**target)
