import json
import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.polynomial.chebyshev import chebval

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.guide import gains, guide
from pgdl_lab.learning.guided import GuidedField, product
from pgdl_lab.learning.modal import DECAY
from pgdl_lab.learning.pod import network_gains
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
from tests.fingers import OBSERVATION, pneunet, solid
from tests.trainings import training

discover()
FINGER = pneunet()
QUICK: dict[str, Any] = {"degree": 5, "rounds": 2}


@pytest.fixture(scope="module")
def data() -> Dataset:
    return solid().simulate(FINGER, OBSERVATION)


@pytest.fixture(scope="module")
def scene(data: Dataset) -> Scene:
    return Scene.of(FINGER, data)


def some(data: Dataset, count: int, below: float = 1.0, seed: int = 0) -> Samples:
    """Samples at `count` points, from the pressures up to `below` times the highest."""
    seen = int((data.pressures_kpa <= below * data.pressures_kpa[-1] * (1 + 1e-9)).sum())
    return Samples.of(data, np.random.default_rng(seed).choice(seen * len(data.domain.points_mm), count, replace=False))


def how(scene: Scene, samples: Samples, folder: Path, **losses: Any) -> Training:
    terms = {name: plugin("loss", name)(**fields) for name, fields in {"data": {}, **losses}.items()}
    budget = TrainerSettings(progress=False, accelerator="cpu", max_epochs=150)
    return Training.of(samples, scene, terms, budget, OptimizerSettings(), 0, folder, {})


def hybrid(**fields: Any) -> Any:
    return plugin("model", "hybrid")(**{**QUICK, **fields})


def pod() -> Any:
    return plugin("model", "pod")(**QUICK)


def rms(surrogate: Any, data: Dataset, which: slice = slice(None)) -> float:
    surrogate.outside = "ignore"
    error = surrogate.predict(data.domain.points_mm, data.pressures_kpa[which]) - data.displacements[which]
    return float(np.sqrt((error**2).mean()))


@pytest.mark.parametrize("below", [1.0, 0.8])
@pytest.mark.parametrize("seed", [0, 1])
def test_from_few_points_it_errs_far_less_than_pod(
    data: Dataset, scene: Scene, below: float, seed: int, tmp_path: Path
) -> None:
    given = how(scene, some(data, 60, below, seed), tmp_path)
    ours, theirs = hybrid().fit(given), pod().fit(given)
    assert rms(ours, data) < 0.7 * rms(theirs, data)
    assert rms(ours, data, slice(-1, None)) < 0.7 * rms(theirs, data, slice(-1, None))
    assert len(ours.record.history) > 1  # a network was trained


def test_the_network_gains_on_the_guide(data: Dataset, scene: Scene, tmp_path: Path) -> None:
    samples = some(data, 60)
    field, shown = hybrid().begin(how(scene, samples, tmp_path))
    assert not field.corrects
    hybrid().fit(how(scene, samples, tmp_path))
    trained = torch.load(tmp_path / "checkpoints" / "last.ckpt", weights_only=True)["best"]

    def error(weights: Any) -> float:
        field.load_state_dict(weights, strict=False)
        fields = field.displacements(field.coordinates(data.domain.points_mm, 0), torch.from_numpy(data.cases.values))
        return float((fields.detach().numpy() - data.displacements).std())

    assert error(trained["weights"]) < 0.5 * error(trained["start"]["weights"])


def test_bars_hold_the_errors_of_guide_network_and_closed_form(data: Dataset, scene: Scene, tmp_path: Path) -> None:
    surrogate = hybrid().fit(how(scene, some(data, 400), tmp_path))
    error = np.abs(surrogate.predict(data.domain.points_mm, data.pressures_kpa) - data.displacements)
    bars = surrogate.error_bar(data.domain.points_mm, data.pressures_kpa)[..., None]
    assert 0.88 < (error <= bars).mean() < 0.999


def test_the_clamp_is_held(data: Dataset, scene: Scene, tmp_path: Path) -> None:
    surrogate = hybrid().fit(how(scene, some(data, 60), tmp_path))
    assert np.abs(surrogate.predict(data.domain.points_mm[data.domain.clamp], data.pressures_kpa)).max() < 1e-6


def alone(model: Any, given: Training, caplog: pytest.LogCaptureFixture) -> str:
    """What a model says that turns out to be `pod`."""
    with caplog.at_level(logging.INFO, "pgdl_lab"):
        surrogate = model.fit(given)
    points, kpa = given.scene.domain.points_mm, np.array([0.0, 10.0, 20.0])
    same = pod().fit(replace(given, losses={"data": given.losses["data"]}))
    assert np.array_equal(surrogate.predict(points, kpa), same.predict(points, kpa))
    assert np.array_equal(surrogate.error_bar(points, kpa), same.error_bar(points, kpa))
    assert surrogate.model["guide"] == "none"
    (line,) = [record.getMessage() for record in caplog.records if "pod alone" in record.getMessage()]
    return line


def test_pod_alone_answers_without_a_guide(
    data: Dataset, scene: Scene, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    said = alone(hybrid(guide="none"), how(scene, some(data, 100), tmp_path), caplog)
    assert said == "Model hybrid: pod alone answers, as model.guide is none."


def test_pod_alone_answers_where_the_finger_is_not_known(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    said = alone(hybrid(), training(tmp_path, {"data": {}}), caplog)
    assert "fem=rod cannot guide it (the finger behind the data is not known)" in said


def test_pod_alone_answers_where_the_guide_misleads(
    data: Dataset, scene: Scene, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A guide of another finger, whose field is rough where this one is not."""
    noise = np.random.default_rng(0).normal(size=guide(scene, "rod", 20.0, QUICK["degree"]).shape)
    monkeypatch.setattr("pgdl_lab.learning.guide.guide", lambda *_: noise)
    assert "fem=rod as a guide would not lower its error" in alone(
        hybrid(), how(scene, some(data, 200), tmp_path), caplog
    )


def test_a_loss_that_trains_nothing_is_named(scene: Scene, data: Dataset, tmp_path: Path, caplog: Any) -> None:
    given = how(scene, some(data, 100), tmp_path, navier_cauchy={}, boundary={"weight": 0.0})
    said = alone(hybrid(guide="none"), given, caplog)
    assert said.endswith("Loss navier_cauchy trains nothing then: leave it out or choose model=body.")
    assert any(record.levelno == logging.WARNING for record in caplog.records)


@pytest.mark.parametrize("count", [60, 4000])
def test_the_early_test_looks_at_a_part_of_many_samples(
    count: int, data: Dataset, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pgdl_lab.learning.guide.TRIED", 1200)
    samples, seen = some(data, count), []
    from pgdl_lab.learning import guide as module

    regression = module.SeparableRegression

    def watched(body: Any, clamp: Any, part: Samples, *others: Any) -> Any:
        seen.append(len(part.pressures_kpa))
        return regression(body, clamp, part, *others)

    monkeypatch.setattr(module, "SeparableRegression", watched)
    nodal = guide(scene, "rod", 20.0, 5)
    gains(scene, samples, nodal, 5, np.random.default_rng(0))
    assert len(seen) == 2 and max(seen) <= min(count, 1.2 * 1200)


def test_what_the_guide_warns_of_is_not_said(data: Dataset, scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    guide(scene, "rod", 19.0, 3)  # not asked for before
    assert not caplog.records
    logging.getLogger("pgdl_lab.mechanics.reduced").warning("as before")
    assert caplog.records


def field_of(points: np.ndarray, guide_mm: np.ndarray) -> GuidedField:
    """A field with random weights on two triangles."""
    torch.manual_seed(0)
    deep = torch.nn.Sequential(torch.nn.Linear(1, 5), torch.nn.Tanh(), torch.nn.Linear(5, 9))
    triangles = torch.tensor([[0, 1, 2], [1, 3, 2]])
    field = GuidedField(
        torch.from_numpy(points), triangles, torch.from_numpy(guide_mm), torch.tensor([0.0, 50.0]).double(), deep
    )
    torch.nn.init.normal_(field.last.weight)
    return field


def test_rows_of_a_product() -> None:
    x, z = torch.tensor([0.3]), torch.tensor([0.7])
    left = torch.stack([x * x * z, 2 * x * z, x * x, 2 * z, 0 * x, 2 * x])
    right = torch.stack([x + z * z, 1 + 0 * x, 2 * z, 0 * x, 2 + 0 * x, 0 * x])
    both = x**3 * z + x**2 * z**3
    expected = [
        *(both, 3 * x**2 * z + 2 * x * z**3, x**3 + 3 * x**2 * z**2),
        *(6 * x * z + 2 * z**3, 6 * x**2 * z, 3 * x**2 + 6 * x * z**2),
    ]
    for order in (1, 3, 6):
        assert torch.allclose(product(left[:order], right[:order]), torch.stack(expected[:order]))


def test_derivatives_of_the_field_are_those_of_its_values() -> None:
    points = np.array([[0.0, 0.0], [8.0, 0.0], [0.0, 3.0], [8.0, 3.0]])
    field = field_of(points, np.zeros((4, 4, 2)))
    place = torch.tensor([[2.0, 1.0], [6.0, 2.5]], dtype=torch.double, requires_grad=True)
    kpa = torch.tensor([10.0, 30.0], dtype=torch.double)

    def coordinates(order: int) -> torch.Tensor:
        rows = torch.zeros(order, 2, 10, dtype=torch.double)
        rows[0, :, :2] = place
        if order > 1:
            rows[1, :, 0] = rows[2, :, 1] = 1
        return rows

    rows = field.rows(coordinates(6), kpa[:, None])
    for component in range(2):
        value = field.rows(coordinates(1), kpa[:, None])[0, :, component]
        (slope,) = torch.autograd.grad(value.sum(), place, create_graph=True)
        assert torch.allclose(rows[0, :, component], value)
        assert torch.allclose(rows[1:3, :, component], slope.T)
        xx, xz = torch.autograd.grad(slope[:, 0].sum(), place, retain_graph=True)[0].T
        zz = torch.autograd.grad(slope[:, 1].sum(), place, retain_graph=True)[0][:, 1]
        assert torch.allclose(rows[3:, :, component], torch.stack([xx, zz, xz]))


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("motion", [0, 1, 2])
def test_sections_move_along_x_and_z_and_turn(motion: int, order: int) -> None:
    """One output of the network is 1: 2 mm of a motion at the tip, half of it in the middle, none at the clamp."""
    points = np.array([[0.0, 0.0], [8.0, 0.0], [0.0, 3.0], [8.0, 3.0]])
    guide_mm = np.random.default_rng(0).normal(scale=0.5, size=(4, 4, 2))
    field = field_of(points, guide_mm)
    with torch.no_grad():
        field.last.weight.zero_()
        field.last.bias.zero_()
        assert not field.corrects
        field.last.bias[3 * motion + order] = 1.0
        field.size_mm.fill_(2.0)
    asked, kpa = np.array([*points, [4.0, 0.0], [4.0, 3.0]]), np.array([10.0, 30.0, 60.0, 20.0, 5.0, 50.0])
    guided = np.array([*guide_mm, (guide_mm[0] + guide_mm[1]) / 2, (guide_mm[2] + guide_mm[3]) / 2])
    guided = np.array([chebval(p / 25 - 1, at) for p, at in zip(kpa, guided, strict=True)])
    x, z = (asked + guided).T
    along = [(1 + 0 * x, 0 * x), (0 * x, 1 + 0 * x), (-z / 8, x / 8)][motion]
    arm = 2.0 * asked[:, 0] / 8 * DECAY**order * np.array([chebval(p / 25 - 1, np.eye(3)[order]) for p in kpa])
    with torch.no_grad():
        found = field(field.coordinates(asked, 0), torch.from_numpy(kpa[:, None])).numpy()
    assert found - guided == pytest.approx(arm[:, None] * np.stack(along, axis=1)) and field.corrects


def test_a_network_begins_in_the_size_of_what_the_guide_errs_by() -> None:
    points = np.array([[0.0, 0.0], [8.0, 0.0], [0.0, 3.0], [8.0, 3.0]])
    guide_mm = np.random.default_rng(0).normal(size=(4, 4, 2))
    field, kpa = field_of(points, guide_mm), np.array([0.0, 50.0, 20.0, 30.0])
    guided = np.array([chebval(p / 25 - 1, at) for p, at in zip(kpa, guide_mm, strict=True)])
    field.scale_to(Samples(points, Cases.path(kpa), guided + [3.0, -4.0]))
    assert float(field.size_mm) == pytest.approx(5 / np.sqrt(2))
    with torch.no_grad():
        field.last.weight.zero_()
        field.last.bias.zero_()
    assert not field.shifts_mm(Samples(points, Cases.path(kpa), guided + [3.0, -4.0]), np.ones(4, dtype=bool)).any()


def test_nodal_form_is_the_field_and_a_refit_to_all_is_near_what_was_trained(data: Dataset, scene: Scene) -> None:
    nodal = guide(scene, "rod", 20.0, 5)
    points = data.domain.points_mm
    field = field_of(points, nodal)
    field.triangles, field.range_kpa = torch.from_numpy(data.domain.cells), torch.tensor([0.0, 20.0]).double()
    with torch.no_grad():
        kpa = torch.tensor([0.0, 7.0, 24.0], dtype=torch.double)
        whole = field.displacements(field.coordinates(points, 0), kpa[:, None]).numpy()
        polynomials = field._polynomials(kpa, 6).numpy()
    # the turn of a place that moves as a polynomial of degree 5, by an angle of degree 2, is one of degree 7
    assert np.einsum("pd,ndc->pnc", polynomials, field.nodal()) == pytest.approx(whole, abs=1e-3)

    samples = some(data, 500)
    made = replace(samples, displacements_mm=samples.displacements_mm)
    with torch.no_grad():
        moved = field(field.coordinates(made.points_mm, 0), torch.from_numpy(made.cases.values)).numpy()
    own = replace(samples, displacements_mm=moved)  # data that the network explains fully
    assert np.abs(field.shifts_mm(own, np.arange(500) % 2 == 0)).max() < 1e-3
    off = replace(own, displacements_mm=moved + np.array([0.1, 0.0]) * (samples.points_mm[:, :1] / 24))
    assert np.abs(field.shifts_mm(off, np.arange(500) % 2 == 0) + (off.displacements_mm - moved)).max() < 1e-2


def test_its_closed_form_needs_data(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"model=hybrid is fitted to the data, and loss=\[boundary\] does not count"):
        hybrid().fit(training(tmp_path, {"boundary": {}}))


@pytest.mark.parametrize("helps", [True, False])
def test_the_network_stays_where_the_closed_form_errs_less_on_what_it_leaves(
    helps: bool, data: Dataset, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = how(scene, some(data, 300), tmp_path)
    field, _ = hybrid().begin(given)
    torch.manual_seed(0)
    torch.nn.init.normal_(field.last.weight, std=10.0)
    plain = field.without_network()
    assert field.corrects and not plain.corrects
    moved, alone = (
        each(each.coordinates(given.whole.points_mm, 0), torch.from_numpy(given.whole.cases.values)).detach().numpy()
        for each in (field, plain)
    )
    if helps:  # data of which it is a part; else they know nothing of it
        for samples in (given.samples, given.held):
            here = field.coordinates(samples.points_mm, 0), torch.from_numpy(samples.cases.values)
            samples.displacements_mm[:] += (field(*here) - plain(*here)).detach().numpy()
    assert np.abs(moved - alone).max() > 1
    monkeypatch.setattr(GuidedField, "shifts_mm", lambda _, samples, kept: np.zeros_like(samples.displacements_mm))
    assert network_gains(given, QUICK["degree"], QUICK["rounds"], field, 0.0) == helps


def test_a_network_that_does_not_gain_is_left_out_with_a_word(
    data: Dataset, scene: Scene, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pgdl_lab.learning.pod.network_gains", lambda *_: False)
    monkeypatch.setattr("pgdl_lab.learning.guide.gains", lambda *_: True)
    given = how(scene, some(data, 400), tmp_path)
    with caplog.at_level(logging.INFO, "pgdl_lab"):
        surrogate = hybrid().fit(given)
    field, _ = hybrid().begin(given)
    alone = hybrid().finished(field, surrogate.record, given)
    assert "the network is left out, as fem=rod alone guides better" in caplog.text
    assert np.array_equal(surrogate.predict(data.domain.points_mm, 10.0), alone.predict(data.domain.points_mm, 10.0))


def test_a_guide_that_does_not_exist_is_refused_before_anything_is_simulated() -> None:
    with pytest.raises(InputError, match="model.guide is 'rood'; choose one of calculix, rod, section, solid, none"):
        hybrid(guide="rood").left_out({"data": plugin("loss", "data")()})


def test_its_file_is_read_by_a_program_that_knows_no_finite_elements(
    data: Dataset, scene: Scene, tmp_path: Path
) -> None:
    surrogate = hybrid().fit(how(scene, some(data, 60), tmp_path))
    assert surrogate.model["guide"] == "rod"
    surrogate.save(tmp_path / "surrogate.pt")
    robot = "import sys, pgdl_lab; print(pgdl_lab.load(sys.argv[1]).predict([[20.0, 0.0]], 10.0).tolist())"
    done = subprocess.run(
        [sys.executable, "-c", robot, str(tmp_path / "surrogate.pt")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == surrogate.predict([[20.0, 0.0]], 10.0).tolist()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"correction_degree": 6}, "model.correction_degree is 6; it must not be above model.degree=5"),
        ({"correction_degree": -1}, "model.correction_degree is -1"),
        ({"degree": 0}, "model.degree is 0"),
        ({"rounds": -1}, "model.rounds is -1"),
        ({"dtype": "float32"}, "model.dtype of hybrid is float64"),
        ({"patience": 0}, "model.patience is 0"),
    ],
)
def test_settings_are_checked(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        hybrid(**fields)
