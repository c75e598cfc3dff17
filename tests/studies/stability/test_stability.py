import json
import logging
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from pgdl_lab.core import paths, registry, sources
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.observation import Observation
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.doubt import trained
from pgdl_lab.learning.scene import Scene
from pgdl_lab.mechanics import path
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.vtk import HEXAHEDRON
from pgdl_lab.running.composing import experiment
from pgdl_lab.studies.stability import learning, mechanics, run, truth
from pgdl_lab.studies.stability.claims import claim
from pgdl_lab.studies.stability.figure import draw
from pgdl_lab.studies.stability.outcome import GOOD, Attempt, Heard, Result, Trial, tried
from pgdl_lab.studies.stability.overlap import overlaps
from pgdl_lab.studies.stability.page import write_page
from pgdl_lab.studies.stability.verdict import judge
from pgdl_lab.surrogate.limits import Outside
from tests.fingers import pneunet

FINGER = pneunet(chambers=1, max_kpa=10.0)


def settings(**changes: Any) -> run.StabilitySettings:
    stored: Any = OmegaConf.to_container(OmegaConf.load(paths.CONF / "task" / "stability.yaml"))
    return run.StabilitySettings(**{**stored["stability"], **changes})


def attempting(error: float, warn: bool = False) -> Attempt:
    def attempt(heard: Heard) -> Result:
        with heard:
            if warn:
                logging.getLogger("pgdl_lab.somewhere").warning("mind this")
        logging.getLogger("pgdl_lab.somewhere").warning("of the truth")
        return Result(error)

    return attempt


def trial(error: float, warn: bool = False, part: str = "learning") -> Trial:
    return tried(part, "noise", "5%", "mlp", attempting(error, warn))


def raising(error: Exception) -> Trial:
    def attempt(heard: Heard) -> Result:
        with heard:
            raise error

    return tried("learning", "noise", "5%", "mlp", attempt)


def test_outcomes_are_told_apart() -> None:
    assert [trial(error).mode for error in (0.5 * GOOD, 2 * GOOD, 0.9, np.nan)] == [
        *("ok", "wrong", "stalled", "not a number")
    ]
    assert trial(0.9, part="mechanics").mode == "wrong"
    assert raising(LabError("it stopped at 3 kPa")).told == ("it stopped at 3 kPa",)
    assert raising(LabError("it stopped")).mode == "stopped" and raising(InputError("too thin")).mode == "refused"
    crashed = raising(ZeroDivisionError("oh"))
    assert (crashed.mode, crashed.told) == ("crashed", ("ZeroDivisionError: oh",))


def warned(warning: Warning, heard: Heard) -> Result:
    with heard:
        warnings.warn(warning, stacklevel=2)
    return Result(0.9)


def test_only_the_lab_is_heard_and_only_while_the_method_works() -> None:
    assert trial(2 * GOOD).told == () and trial(2 * GOOD, warn=True).told == ("mind this",)
    asked = tried("learning", "extrapolation", "75", "mlp", lambda heard: warned(Outside("far"), heard))
    assert asked.told == ("far",)
    other = tried("learning", "noise", "5%", "mlp", lambda heard: warned(UserWarning("of a library"), heard))
    assert other.told == ()


def test_the_page_lists_silent_failures_first_and_counts_all(tmp_path: Path) -> None:
    trials = [trial(0.01), trial(0.2), trial(0.3, warn=True), raising(LabError("stopped"))]
    write_page(trials, ["made so"], tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text()
    assert text.index("made so") < text.index("## Silently wrong: 2 of 4 trials") < text.index("## Methods")
    assert "- 2 × **mlp**, noise (5%): mesh or model are too coarse; errs by up to 30.0%" in text
    assert "## Crashed: 0 of 4 trials\n\nNone." in text
    assert "| mlp | 4 | 1 | 0 | 0 | 0 | 2 | 1 | 0 | 0 | – | – | – | – | 1.00% |" in text
    assert "| mlp | noise | 1 of 4 | 5% … 70% | 1 | 2 | 0 | 0 | 1 | 0 | 0 |" in text
    assert "- 1 × mlp (no rule tells what it claims; first: noise, 5%; wrong): mind this" in text
    draw(trials, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 1000


def test_trials_are_made_once(tmp_path: Path) -> None:
    def plan(level: str, error: float) -> run.Planned:
        path = run._path(tmp_path, FINGER, learning.Stress("noise", level), "mlp", [1])
        return run.Planned("learning", "noise", level, "mlp", 0, path, attempting(error, warn=True))

    first, again, other = plan("5%", 0.01).trial(), plan("5%", 0.9).trial(), plan("1%", 0.9).trial()
    assert first == again != other
    assert len(list(tmp_path.rglob("*.json"))) == 2
    assert Trial.of(json.loads(next(iter(tmp_path.rglob("*.json"))).read_text())) in (first, other)


@pytest.mark.parametrize(
    ("part", "method", "module", "counts"),
    [
        ("mechanics", "rod", "pgdl_lab.studies.stability.overlap", True),
        ("mechanics", "rod", "pgdl_lab.mechanics.path", True),
        ("mechanics", "rod", "pgdl_lab.studies.stability.verdict", False),
        ("learning", "mlp", "pgdl_lab.learning.module", True),
        ("learning", "mlp", "pgdl_lab.mechanics.path", True),
        ("learning", "mlp", "pgdl_lab.studies.stability.truth", False),
    ],
)
def test_trials_count_the_code_that_decides_how_they_end(part: str, method: str, module: str, counts: bool) -> None:
    kind, attempt = run.PARTS[part]
    files, _ = sources.reached([registry.plugin(kind, method), attempt, registry.plugin("fem", "solid")])
    assert (module in files) == counts


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
    monkeypatch.setattr(truth, "WHOLE_EDGE_MM", 12.0)


def mechanical(axis: str, level: str, method: str) -> Trial:
    (stress,) = [each for each in mechanics.stresses(FINGER, False) if (each.axis, each.level) == (axis, level)]
    coarse = replace(stress, edge_mm=6.0)
    return tried("mechanics", axis, level, method, lambda heard: mechanics.attempt(coarse, method, heard))


def test_one_load_step_and_a_distorted_mesh_are_no_trouble_for_the_solid() -> None:
    stepped = mechanical("load steps", "1", "solid")
    assert stepped.causes == () and [bar.what for bar in stepped.bars] == ["mesh"]
    assert mechanical("distorted mesh", "20%", "solid").causes == ()
    assert path.LARGEST_STEP < 1  # what was meddled with is as it was


def leaning_by(share: float) -> truth.Truth:
    """A truth in which the tip goes down by 1 mm, and the whole body across by a `share` of that."""

    def state(finger: Finger, across: float) -> truth.State:
        model = Model(finger, 12.0, "hex27_p1")
        x = model.discretisation.positions[:, :1]
        return truth.State(model, x / x.max() * [0.0, across, -1.0], unstable=False)

    return truth.Truth(state(FINGER, 0.0), state(replace(FINGER, gravity_m_s2=[0.0, 1e-3, -9.81]), share))


def test_who_gives_way_to_a_side_must_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    (stress,) = [each for each in mechanics.stresses(FINGER, True) if each.axis == "gravity"]
    found = registry.plugin("fem", "section")(edge_mm=12.0).simulate(stress.finger, mechanics.OBSERVATION)
    bent = leaning_by(0.0).at(np.insert(found.domain.points_mm, 1, 8.0, axis=1))[:, [0, 2]]
    found.displacements[-1] = bent
    monkeypatch.setattr(mechanics, "reference", lambda *_: leaning_by(0.04))
    upright = mechanics.judged(found, stress)
    assert upright.causes == () and upright.error < 1e-9
    monkeypatch.setattr(mechanics, "reference", lambda *_: leaning_by(0.5))
    leaning = mechanics.judged(found, stress)
    assert leaning.causes == ("unstable",) and leaning.error == pytest.approx(0.5)


def test_a_ceiling_that_passes_through_its_floor_is_seen_without_the_code_of_contact() -> None:
    low = mechanics._low(FINGER, 1.2)
    found = {
        mode: registry.plugin("fem", "solid")(edge_mm=12.0, contact=mode, estimate_error=False).simulate(
            low, Observation(1, 50)
        )
        for mode in ("off", "auto")
    }
    assert overlaps(found["off"].body) and not overlaps(found["auto"].body)


@pytest.mark.parametrize("nodes", [20, 27])
def test_half_a_body_overlaps_with_its_mirror_image(nodes: int) -> None:
    """A brick beside the plane y = 0, 0.5 mm from it, that is moved across."""

    def moved(y_mm: float) -> Dataset:
        at = 2 * HEXAHEDRON[:nodes] + [0.0, 0.5, 0.0]
        shift = np.broadcast_to([0.0, y_mm, 0.0], (1, nodes, 3))
        return Dataset.path(Domain(at, np.arange(nodes)[None], f"hexahedron{nodes}"), np.array([1.0]), shift)

    assert [overlaps(moved(y_mm)) for y_mm in (0.0, -0.5, -0.52, -0.54, -1.0)] == [False, False, False, True, True]


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


def learnt(stress: learning.Stress, method: str, data: Any, updates: int = 20) -> Trial:
    return tried("learning", stress.axis, stress.level, method,
                 lambda heard: learning.attempt(stress, method, data, FINGER, 0, updates, heard))  # fmt: skip


@pytest.mark.parametrize(
    ("axis", "level", "cause", "bars"),
    [
        ("fewer points", "0.20%", "data", []),  # none is stated from 16 points
        ("extrapolation", "44 to 50", "range", ["95 %"]),
        ("points missing", "40% of the length", "data", ["95 %"]),
    ],
)
def test_what_is_wrong_with_a_closed_form_is_measured(
    data: Any, axis: str, level: str, cause: str, bars: list[str]
) -> None:
    (stress,) = [each for each in learning.stresses(False) if (each.axis, each.level) == (axis, level)]
    found = learnt(stress, "finite_element", data)
    assert cause in found.causes and cause in {claim(sentence).cause for sentence in found.told}
    assert [bar.what for bar in found.bars] == bars and judge(found).outcome == "wrong, says so"


def test_bars_hold_where_a_stretch_has_no_training_points(data: Any) -> None:
    (stress,) = [each for each in learning.stresses(False) if each.level == "40% of the length"]
    (bar,) = learnt(stress, "pod", data).bars
    assert bar.holds and bar.ratio > 0.5  # calibrated at places like those of the training points they cover 89 %


def test_one_missing_corner_at_the_clamp_is_no_guess(data: Any, tmp_path: Path) -> None:
    """The clamp does not move, which is known: what lies beside it is near to something that is."""
    share = data.domain.points_mm[:, 0] / data.domain.points_mm[:, 0].max()
    for hidden, warned in ((share < 0.12, False), (share > 0.3, True)):
        shown = np.flatnonzero(~np.tile(hidden, len(data.pressures_kpa)))[::3]
        training = learning.Training.of(
            Samples.of(data, shown), Scene.of(FINGER, data), {"data": registry.plugin("loss", "data")()},
            learning._budget(experiment([]), len(shown), 20), experiment([]).optimizer, 0, tmp_path, {},
        )  # fmt: skip
        surrogate = trained(registry.plugin("model", "finite_element")(), training)
        assert any("No training point lies within" in told for told in surrogate.warnings) == warned


def test_a_network_that_has_not_learnt_its_points_is_told_from_one_with_few(data: Any) -> None:
    assert learnt(next(iter(learning.stresses(False))), "mlp", data).causes == ("training",)


def test_a_good_training_is_not_doubted(data: Any) -> None:
    found = learnt(replace(next(iter(learning.stresses(False))), share=0.2), "pod", data)
    assert (found.mode, found.told, judge(found).outcome) == ("ok", (), "right")


def test_a_training_takes_as_many_updates_on_any_machine() -> None:
    how = experiment([])
    assert learning._budget(how, 4000, 100).max_epochs == round(100 / 8)  # 3600 are fitted, 512 at a time
    assert learning._budget(how, 4, 100).max_epochs == 100


@pytest.mark.parametrize(("name", "value"), [("parts", ["mechanic"]), ("seeds", 0), ("updates", 0)])
def test_bad_settings_are_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"stability.{name}"):
        settings(**{name: value})
