import json
import logging
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from pgdl_lab import paths, registry
from pgdl_lab.errors import InputError, LabError
from pgdl_lab.mechanics import path
from pgdl_lab.stability import learning, mechanics, run
from pgdl_lab.stability.outcome import GOOD, Result, Trial, cells, tried, wilson
from pgdl_lab.stability.page import draw, write_page
from pgdl_lab.surrogate import Outside
from tests.fingers import pneunet

FINGER = pneunet(chambers=1, max_kpa=10.0)


def settings(**changes: Any) -> run.StabilitySettings:
    stored: Any = OmegaConf.to_container(OmegaConf.load(paths.CONF / "task" / "stability.yaml"))
    return run.StabilitySettings(**{**stored["stability"], **changes})


def trial(error: float, warn: bool = False, part: str = "learning") -> Trial:
    def attempt() -> Result:
        if warn:
            logging.getLogger("pgdl_lab.somewhere").warning("mind this")
        return Result(error)

    return tried(part, "noise", "5%", "mlp", attempt)


def raising(error: Exception) -> Trial:
    def attempt() -> Result:
        raise error

    return tried("learning", "noise", "5%", "mlp", attempt)


def test_outcomes_are_told_apart() -> None:
    assert [trial(error).mode for error in (0.5 * GOOD, 2 * GOOD, 0.9, np.nan)] == [
        *("ok", "wrong", "stalled", "not a number")
    ]
    assert trial(0.9, part="mechanics").mode == "wrong"
    assert raising(LabError("it stopped at 3 kPa")).told == "it stopped at 3 kPa"
    assert raising(LabError("it stopped")).mode == "stopped" and raising(InputError("too thin")).mode == "refused"
    crashed = raising(ZeroDivisionError("oh"))
    assert (crashed.mode, crashed.told) == ("crashed", "ZeroDivisionError: oh")
    assert not trial(0.5 * GOOD).silent


def warned(warning: Warning) -> Result:
    warnings.warn(warning, stacklevel=2)
    return Result(0.9)


def test_only_what_says_nothing_is_silent() -> None:
    assert trial(2 * GOOD).silent
    assert not trial(2 * GOOD, warn=True).silent
    assert not raising(LabError("stopped")).silent
    asked = tried("learning", "extrapolation", "75", "mlp", lambda: warned(Outside("far")))
    assert asked.told == "far" and not asked.silent
    other = tried("learning", "noise", "5%", "mlp", lambda: warned(UserWarning("of a library")))
    assert other.silent


def test_wilson_interval() -> None:
    low, high = wilson(8, 10)  # as in Brown, Cai and DasGupta, Statistical Science 16, 2001: closed form
    assert (low, high) == (pytest.approx(0.4902, abs=1e-4), pytest.approx(0.9433, abs=1e-4))
    assert wilson(0, 10)[0] == 0 and wilson(10, 10)[1] == 1
    assert wilson(0, 0) == (0.0, 1.0)


def test_the_page_lists_silent_failures_first_and_counts_all(tmp_path: Path) -> None:
    trials = [trial(0.01), trial(0.2), trial(0.3, warn=True), raising(LabError("stopped"))]
    write_page(trials, ["made so"], tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text()
    assert "## Silently wrong: 1 of 4 trials" in text
    assert text.index("**mlp**, noise, 5%: wrong, errs by 20.0%") < text.index("## Success rates")
    assert "| mlp | noise | 1 of 4 |" in text and "2 wrong, 1 stopped (1 without a word)" in text
    assert (
        text.index("made so") < text.index("## Silently wrong")
        and "| mlp | 4 | 1 | 2 | 0 | 0 | 1 | 0 | 0 | 1 |" in text
    )
    assert "1 × mlp (first: noise, 5%; wrong): mind this" in text
    record = cells(trials)["mlp", "noise"].record()
    assert sum(record[mode] for mode in ("ok", "wrong", "stopped")) == record["trials"] == 4
    draw(trials, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 1000


def test_trials_are_made_once(tmp_path: Path) -> None:
    def plan(level: str, error: float) -> run.Planned:
        stress = SimpleNamespace(axis="noise", level=level)
        path = run._path(tmp_path, "learning", stress, "mlp", [1])
        return run.Planned("learning", "noise", level, "mlp", path, lambda: Result(error))

    first, again, other = plan("5%", 0.01).trial(), plan("5%", 0.9).trial(), plan("1%", 0.9).trial()
    assert first == again != other
    assert len(list(tmp_path.rglob("*.json"))) == 2
    assert Trial(**json.loads(next(iter(tmp_path.rglob("*.json"))).read_text())) in (first, other)


def test_trials_count_the_code_of_their_own_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stress = SimpleNamespace(axis="noise", level="5%")

    def paths_of(part: str, method: str) -> list[Path]:
        found = [run._path(tmp_path, part, stress, method, [1])]
        with monkeypatch.context() as patch:
            patch.setitem(run.CODE, "learning", (*run.CODE["learning"], "tracking.py"))
            return [*found, run._path(tmp_path, part, stress, method, [1])]

    assert len(set(paths_of("mechanics", "solid"))) == 1
    assert len(set(paths_of("learning", "mlp"))) == 2


def test_every_axis_has_a_level_for_every_method_that_it_reaches() -> None:
    full, quick = list(mechanics.stresses(FINGER, False)), list(mechanics.stresses(FINGER, True))
    assert {stress.axis for stress in full} == {stress.axis for stress in quick}
    assert len(quick) == len({stress.axis for stress in quick}) < len(full)
    axes = {stress.axis for stress in learning.stresses(False)}
    assert axes == {stress.axis for stress in learning.stresses(True)} and len(axes) == 9
    for stress in quick:
        assert set(mechanics.models(stress)) >= set(registry.names("fem")) - {"calculix"}
    for training in learning.stresses(False):
        left_out = set(registry.names("model")) - set(learning.models(training))
        assert left_out == set() or training.optimizer or training.model
    (rate, *_) = [each for each in learning.stresses(True) if each.axis == "learning rate"]
    assert "mlp" in learning.models(rate) and "pod" not in learning.models(rate)


def test_only_a_model_with_the_setting_is_tried_with_it() -> None:
    contact = {each.level: each for each in mechanics.stresses(FINGER, False) if each.axis == "contact sets in"}
    assert mechanics.models(contact["as it is set"]) == registry.names("fem")
    assert "rod" not in mechanics.models(contact["on"]) and "solid" in mechanics.models(contact["on"])


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mechanics, "EDGE_MM", 12.0)


def mechanical(axis: str, level: str, method: str) -> Trial:
    (stress,) = [each for each in mechanics.stresses(FINGER, False) if (each.axis, each.level) == (axis, level)]
    return tried("mechanics", axis, level, method, lambda: mechanics.attempt(stress, method))


def test_one_load_step_and_a_distorted_mesh_are_no_trouble_for_the_solid() -> None:
    assert mechanical("load steps", "1", "solid").mode == "ok"
    assert mechanical("distorted mesh", "20%", "solid").mode == "ok"
    assert path.LARGEST_STEP < 1  # what was meddled with is as it was


def test_cheap_models_say_that_their_error_is_unknown() -> None:
    said = mechanical("gravity", "0, -98.1 m/s²", "section")
    assert "does not know its own error" in said.told and not said.silent


def test_a_start_far_from_any_equilibrium_is_a_sentence() -> None:
    thrown = mechanical("poor predictor", "1 mm off", "section")
    assert thrown.mode in ("ok", "wrong", "stopped")


def test_distorted_meshes_are_of_the_same_body() -> None:
    even, moved = (finger.mesh(3.0) for finger in (FINGER, mechanics.distorted(FINGER, 0.2)))
    shift = np.abs(even.p - moved.p)
    assert (shift > 0.01).any(axis=0).mean() > 0.1
    assert not shift[[0, 2]][:, even.boundary_nodes()].any()
    assert not shift[:, even.p[1] == 8].any()


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return run._simulated(FINGER, tmp_path_factory.mktemp("data"))


@pytest.mark.parametrize(
    ("axis", "level", "said"),
    [
        ("fewer points", "0.05%", "No training point lies within"),
        ("noise", "5%", "error bars cover"),
        ("extrapolation", "44 to 75", "error bars cover"),
        ("points missing", "40% of the length", "No training point lies within"),
    ],
)
def test_a_closed_form_says_what_is_wrong(data: Any, axis: str, level: str, said: str) -> None:
    (stress,) = [each for each in learning.stresses(False) if (each.axis, each.level) == (axis, level)]
    found = tried("learning", axis, level, "finite_element",
                  lambda: learning.attempt(stress, "finite_element", data, FINGER, 0, 1.0))  # fmt: skip
    assert said in found.told
    assert not found.silent


def test_a_good_training_is_not_doubted(data: Any) -> None:
    stress = replace(next(iter(learning.stresses(False))), share=0.2)
    found = tried("learning", "", "", "pod", lambda: learning.attempt(stress, "pod", data, FINGER, 0, 1.0))
    assert (found.mode, found.told) == ("ok", "")


@pytest.mark.parametrize(("name", "value"), [("parts", ["mechanic"]), ("seeds", 0), ("train_s", 0.0)])
def test_bad_settings_are_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"stability.{name}"):
        settings(**{name: value})
