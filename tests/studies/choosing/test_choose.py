import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe
from pgdl_lab.mechanics import memory
from pgdl_lab.mechanics.elements import ELEMENTS
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.memory import Size
from pgdl_lab.running.composing import experiment
from pgdl_lab.studies.chart.reference import find_reference
from pgdl_lab.studies.choosing.choice import Choice
from pgdl_lab.studies.choosing.climb import check_scene, largest
from pgdl_lab.studies.choosing.settings import ChooseSettings
from pgdl_lab.tasks.choose import choose
from tests.conftest import CHECKOUT, Lab
from tests.fingers import pneunet

OBSERVATION = Observation(10, 400)
FINGER = pneunet(chambers=1, max_kpa=10.0)
SETTINGS = ChooseSettings(cheap=["rod"], models=["finite_element", "pod"], meshes=[2.0, 1.0, 0.5])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("choose")


def chosen(folder: Path, finger: Finger, **asked: Any) -> Choice:
    scene = experiment(["split.points=400", "fem.edge_mm=3"])
    return choose(replace(scene, finger=finger, observation=OBSERVATION), replace(SETTINGS, **asked), folder)


def error_mm(folder: Path, choice: Choice, finger: Finger) -> float:
    description = {"name": "solid", "edge_mm": 6.0, "estimate_error": False}
    reference = find_reference(finger, description, Observation(2, 400), folder)
    shown = choice.surrogate or choice.snapshots
    assert choice.snapshots and shown
    which = reference.among(choice.snapshots.pressures_kpa)
    found = choice.snapshots.displacements[which]
    if choice.surrogate:
        found = choice.surrogate.predict(choice.snapshots.domain.points_mm, choice.snapshots.pressures_kpa[which])
    return largest(found - reference.displacements)


def test_a_coarse_tolerance_takes_the_cheapest_model_and_a_surrogate_if_queries_must_be_quick(folder: Path) -> None:
    choice = chosen(folder, FINGER, tolerance_mm=1.0, budget_ms=5.0)
    assert choice.met
    assert describe(choice.fem)["name"] == "rod"
    assert describe(choice.model)["name"] == "finite_element"
    assert error_mm(folder, choice, FINGER) <= 1.0
    assert [reason.partition(":")[0] for reason in choice.reasons] == [
        *("gravity", "contact", "dimension", "load path", "surrogate", "surrogate")
    ]


def test_a_finer_tolerance_takes_a_solid_and_keeps_its_promise(folder: Path) -> None:
    choice = chosen(folder, FINGER, tolerance_mm=0.1)
    assert choice.met and choice.model is None
    assert describe(choice.fem)["name"] == "solid"
    assert describe(choice.fem)["contact"] == "off"
    assert error_mm(folder, choice, FINGER) <= 0.1


def test_a_tolerance_out_of_reach_is_said_before_the_finest_mesh_is_paid_for(folder: Path) -> None:
    choice = chosen(folder, FINGER, tolerance_mm=1e-4, budget_ms=5.0)
    assert not choice.met and choice.model is None
    assert describe(choice.fem)["edge_mm"] > 3
    assert any(reason.startswith("NOT MET: 0.0001 mm is out of reach") for reason in choice.reasons)


def test_a_mesh_that_needs_more_memory_than_there_is_ends_the_climb(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    coarse = Size.of(FINGER.mesh(6.0)).refined().needed(ELEMENTS["hex27_p1"])
    monkeypatch.setattr(memory, "available", lambda: coarse + 1)
    choice = chosen(folder, FINGER, tolerance_mm=0.03)
    assert not choice.met and describe(choice.fem)["edge_mm"] == 6.0
    assert any("out of reach (The mesh of fem.edge_mm=3" in reason and "GB" in reason for reason in choice.reasons)


def test_what_does_nothing_is_left_out(folder: Path) -> None:
    light = pneunet(chambers=1, gravity_m_s2=[0.0, -1e-3], max_kpa=2.0, material=Yeoh(c2_mpa=1e-6))
    choice = chosen(folder, light, tolerance_mm=0.05, meshes=[2.0])
    assert choice.finger.gravity_m_s2 == [0.0, 0.0]
    assert 0 < choice.dropped_mm < 0.05
    assert any(reason.startswith("gravity: left out") for reason in choice.reasons)


def test_the_answer_runs_as_an_experiment(lab: Lab, tmp_path: Path) -> None:
    typed = ("finger=pneunet_reference", "finger.chambers=1", "finger.max_kpa=5", "fem.edge_mm=6")
    small = ("observation.snapshots=4", "observation.points=300", "split.points=200", "yardstick=null")
    done = lab("task=choose", "tolerance_mm=1", "budget_ms=5", *typed, *small, "trainer.progress=false")
    assert done.returncode == 0, done.stderr
    (file,) = tmp_path.glob("runs/*/choice.json")
    told = json.loads(file.read_text())
    assert told["met"] and told["expected_error_mm"]["all"] <= 1
    again = lab("experiment=choose/pneunet_1mm")
    assert again.returncode == 0, again.stderr
    metrics = json.loads((tmp_path / "runs" / "latest" / "metrics.json").read_text())
    assert (metrics["fem"], metrics["model"]) == (told["fem"]["name"], told["model"]["name"])
    most = max(row["max_abs_mm"] for row in metrics["by_pressure"])
    assert most <= told["expected_error_mm"]["surrogate"] * (1 + 1e-3)


@pytest.mark.parametrize("value", [0, -1.0, np.inf, "much"])
def test_a_tolerance_must_be_a_length(value: Any) -> None:
    with pytest.raises(InputError, match="tolerance_mm is"):
        ChooseSettings(tolerance_mm=value)


def test_a_quick_query_needs_a_model_to_choose_from() -> None:
    with pytest.raises(InputError, match=r"choose\.models names no surrogate"):
        ChooseSettings(budget_ms=1.0)


def test_a_mesh_of_ones_own_is_refused() -> None:
    scene = experiment(["finger=mesh", f"finger.path={CHECKOUT / 'examples' / 'finger.msh'}"])
    with pytest.raises(InputError, match="no mesh can be chosen"):
        check_scene(scene)
