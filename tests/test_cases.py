"""Several inputs: simulations that differ in more than their pressures, and what learns from them."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import plugin
from pgdl_lab.export.export import Form, export
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.doubt import trained
from pgdl_lab.learning.polynomials import MOST, basis_of
from pgdl_lab.surrogate import archive
from pgdl_lab.surrogate.calibration import bar_deviations
from pgdl_lab.surrogate.limits import Outside, TooFar, along
from pgdl_lab.surrogate.loading import load
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.synthetic import snapshots
from tests.trainings import scene, training

DEGREES = (-60.0, -30.0, 0.0, 20.0, 45.0, 60.0)
MODELS: dict[str, dict[str, Any]] = {
    "pod": {"degree": 6, "draws": 32},
    "finite_element": {"degree": 5},
    "gaussian_process": {"points": 300, "modes": 8},
    "mlp": {"depth": 1, "width": 12},
    "body": {"depth": 1, "width": 8, "modes": 16, "degree": 4},
}
LINEAR = ("pod", "finite_element")


def turned(deg: float) -> Dataset:
    """The made-up finger, bent less or more, and pushed across by what is no product of place and pressure."""
    one = snapshots(cell_mm=2.5, count=10)
    share, angle = one.pressures_kpa[:, None] / 50, np.deg2rad(deg)
    moved = np.cos(angle) * one.displacements
    moved[..., 1] += 3 * np.sin(angle + share) * (one.domain.points_mm[:, 0] / 100) ** 2
    return Dataset.path(one.domain, one.pressures_kpa, moved, provenance={"finger": {"name": "comb"}, "deg": deg})


joined = cache(lambda: Dataset.joined([turned(deg) for deg in DEGREES], gravity_deg=DEGREES))


@cache
def surrogate(name: str) -> Surrogate:
    data = joined()
    points = np.sort(np.random.default_rng(0).choice(data.displacements[..., 0].size, 3000, replace=False))
    folder = Path("unused") if name in (*LINEAR, "gaussian_process") else Path(".")
    how = training(folder, {"data": {}}, samples=Samples.of(data, points), scene=scene(data), max_epochs=2)
    return plugin("model", name)(**MODELS[name]).fit(how)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_joined_simulations_have_one_more_input(tmp_path: Path) -> None:
    data = joined()
    assert data.cases.names == ["pressure_kpa", "gravity_deg"] and data.displacements.shape[0] == 60
    assert [(each.unit, each.low, each.high) for each in data.cases.inputs] == [("kPa", 5.0, 50.0), ("°", -60.0, 60.0)]
    for number, part in enumerate(data.cases.simulations):
        assert np.array_equal(part, np.arange(10 * number, 10 * number + 10))
        assert set(data.cases.values[part, 1]) == {DEGREES[number]}
        assert np.array_equal(data.displacements[part], turned(DEGREES[number]).displacements)
    assert data.provenance["finger"] == {"name": "comb"} and "deg" not in data.provenance
    assert [each["deg"] for each in data.provenance["simulations"]] == list(DEGREES)
    data.save(tmp_path / "a.h5")
    read = Dataset.load(tmp_path / "a.h5")
    assert read.cases.inputs == data.cases.inputs and read.cases.ranges() == data.cases.ranges()
    assert np.array_equal(read.cases.simulation, data.cases.simulation)
    again = Dataset.joined([data, data], wall_mm=[1.0, 2.0])
    assert again.cases.names == ["pressure_kpa", "gravity_deg", "wall_mm"] and len(again.cases.simulations) == 12


def test_bodies_are_joined_where_all_have_one() -> None:
    whole = [replace(turned(deg), body=turned(deg)) for deg in (0.0, 10.0)]
    body = Dataset.joined(whole, gravity_deg=[0.0, 10.0]).body
    assert body is not None and body.cases.ranges()["gravity_deg"] == [0.0, 10.0]
    assert Dataset.joined([whole[0], turned(10.0)], gravity_deg=[0.0, 10.0]).body is None


@pytest.mark.parametrize(
    ("second", "values", "told"),
    [
        (lambda: turned(1.0), {"gravity_deg": [1.0]}, "gravity_deg is .* give one finite number for each of the 2"),
        (lambda: turned(1.0), {"gravity_deg": [1.0, np.nan]}, "give one finite number"),
        (lambda: turned(1.0), {"gravity_deg": [1.0, 1.0]}, "gravity_deg is 1 in all simulations"),
        (lambda: turned(1.0), {"pressure_kpa": [1.0, 2.0]}, "'pressure_kpa' is an input of the simulations already"),
        (lambda: turned(1.0), {}, "takes at least one simulation, and a value"),
        (lambda: snapshots(cell_mm=3.0, count=2), {"gravity_deg": [1.0, 2.0]}, "lives on another mesh"),
        (joined, {"wall_mm": [1.0, 2.0]}, "has inputs .*gravity_deg"),
    ],
)
def test_what_cannot_be_joined_is_told(second: Any, values: dict[str, list[float]], told: str) -> None:
    with pytest.raises(InputError, match=told):
        Dataset.joined([turned(0.0), second()], **values)


def test_splits_choose_simulations_and_ranges_of_inputs() -> None:
    cases = joined().cases
    seen = plugin("split", "simulations")(held_out=0.34).seen(cases)
    kept = [seen[part].all() for part in cases.simulations]
    assert sum(kept) == 4 and all(
        seen[part].any() == whole for part, whole in zip(cases.simulations, kept, strict=True)
    )
    other = plugin("split", "simulations")(held_out=0.34, draw=1).seen(cases)
    assert not np.array_equal(seen, other)
    below = plugin("split", "extrapolate")(input="gravity_deg", train_fraction=0.7, tested=[1.0]).seen(cases)
    assert np.array_equal(below, cases.column("gravity_deg") <= -60 + 0.7 * 120)
    few = plugin("split", "snapshots")(train_snapshots=3).seen(cases)
    assert all(few[part].sum() == 3 for part in cases.simulations)
    with pytest.raises(InputError, match=r"split\.input is 'wall_mm'; the inputs of these data are pressure_kpa, grav"):
        plugin("split", "extrapolate")(input="wall_mm").seen(cases)
    with pytest.raises(InputError, match="hold one simulation, of which none can be held out"):
        plugin("split", "simulations")().seen(Cases.path(np.arange(1.0, 5.0)))


@pytest.mark.parametrize("change", [{"held_out": 0.0}, {"held_out": 1.0}, {"draw": -1}])
def test_shares_of_simulations_have_limits(change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"split.{next(iter(change))} is"):
        plugin("split", "simulations")(**change)


def test_bars_are_calibrated_on_whole_simulations() -> None:
    cases, asked = joined().cases, []

    def ratios(held: Any, judged: Any) -> Any:
        asked.append((held, judged))
        return np.ones((judged.sum(), 2))

    assert bar_deviations(cases, ratios, np.random.default_rng(0)) is not None
    *inside, (_, top) = asked
    assert len(inside) == len(DEGREES) and sum(held for held, _ in inside).tolist() == [1] * 60  # type: ignore[attr-defined]
    assert all(len(set(held[part])) == 1 for held, _ in inside for part in cases.simulations)
    assert set(cases.pressures_kpa[top]) == {50.0}


def test_how_far_along_a_case_lies_outside_counts_as_above() -> None:
    ranges = [[0.0, 50.0], [-60.0, 60.0]]
    cases = np.array([[20.0, 0.0], [20.0, 60.0], [20.0, 72.0], [20.0, -84.0], [60.0, 66.0], [60.0, 96.0]])
    assert along(cases, ranges) == pytest.approx([20, 20, 55, 60, 60, 65])
    assert np.array_equal(along(cases[:, :1], ranges[:1]), cases[:, 0])


def test_polynomials_are_no_more_than_values_determine_and_solves_can_bear() -> None:
    degrees = np.array(basis_of(joined().cases, 4).degrees)
    assert degrees.sum(axis=1).max() == 4 and len(degrees) == 15
    two = Dataset.joined([turned(0.0), turned(10.0)], gravity_deg=[0.0, 10.0])
    assert np.array(basis_of(two.cases, 4).degrees)[:, 1].max() == 1
    many = basis_of(joined().cases, 12)
    assert (
        len(many.degrees) <= MOST < len(basis_of(replace(joined().cases, inputs=joined().cases.inputs), 7).degrees) + 9
    )
    assert basis_of(Cases.path(np.array([5.0, 50.0])), 12).ranges == ((0.0, 50.0),)


@pytest.mark.parametrize("name", MODELS)
def test_every_model_takes_several_inputs(name: str, tmp_path: Path) -> None:
    found, data = surrogate(name), joined()
    points = data.domain.points_mm[::5]
    assert found.inputs == ["pressure_kpa", "gravity_deg"] and found.ranges["gravity_deg"] == [-60.0, 60.0]
    kpa = np.array([10.0, 30.0])
    several = found.predict(points, {"pressure_kpa": kpa, "gravity_deg": 10.0})
    alone = found.predict(points, {"gravity_deg": 10, "pressure_kpa": 30.0})
    assert several.shape == (2, len(points), 2) and alone == pytest.approx(several[1], abs=1e-6)
    at = found.at(points)
    assert at({"pressure_kpa": 30.0, "gravity_deg": 10.0}) == pytest.approx(alone, abs=1e-6)
    slope = at.slope({"pressure_kpa": 30.0, "gravity_deg": 10.0})
    for number, (name_of, step) in enumerate((("pressure_kpa", 0.5), ("gravity_deg", 0.5))):
        middle = {"pressure_kpa": 30.0, "gravity_deg": 10.0}
        ahead, behind = (at(middle | {name_of: middle[name_of] + sign * step}) for sign in (1, -1))
        assert slope[..., number] == pytest.approx((ahead - behind) / (2 * step), abs=2e-3)
    found.save(tmp_path / "s.pt")
    restored = load(tmp_path / "s.pt")
    case = {"pressure_kpa": kpa, "gravity_deg": [10.0, -20.0]}
    assert np.array_equal(restored.predict(points, case), found.predict(points, case))
    bars = found.error_bar(points, case)
    assert bars is not None and bars.shape == (2, len(points))
    held = restored.holding(gravity_deg=10.0)
    assert held.inputs == ["pressure_kpa"] and held.predict(points, 30.0) == pytest.approx(alone, abs=1e-6)
    assert held.at(points).slope(30.0) == pytest.approx(slope[..., 0], abs=1e-9)
    target = held.tip_mm + held.predict(held.tip_mm[None], 30.0)[0]
    if name in LINEAR:
        assert float(held.pressure_for(tip=target.tolist())) == pytest.approx(30.0, abs=0.01)
        assert "gravity_deg = 0" in restored._repr_html_()
    if bars is not None:
        told, whole = held.error_bar(points, 30.0), restored.error_bar(points, {"pressure_kpa": 30, "gravity_deg": 10})
        assert told is not None and np.array_equal(told, whole)  # type: ignore[arg-type]
        outside = restored.error_bar(points, {"pressure_kpa": 30.0, "gravity_deg": 75.0})
        assert outside is not None and np.median(outside) > (1.0 if name == "mlp" else 1.2) * np.median(told)


@pytest.mark.parametrize("name", LINEAR)
def test_simulations_that_nobody_trained_on_are_told_and_bars_cover_the_error(name: str) -> None:
    found = surrogate(name)
    for deg in (-45.0, 8.0, 33.0):
        data = turned(deg)
        case = {"pressure_kpa": data.pressures_kpa, "gravity_deg": deg}
        error = np.abs(found.predict(data.domain.points_mm, case) - data.displacements)
        bars = found.error_bar(data.domain.points_mm, case)
        assert bars is not None and (error <= bars[..., None]).mean() > 0.9 and np.median(bars) < 0.5
        assert np.sqrt((error**2).mean()) < 0.01 * np.sqrt((data.displacements**2).mean())


def test_questions_about_several_inputs_are_checked() -> None:
    found, point = surrogate("finite_element"), [[20.0, 5.0]]
    for asked, told in [
        (20.0, r"has 2 inputs: give each by its name, as in {'pressure_kpa': …, 'gravity_deg': …}"),
        ({"pressure_kpa": 20.0}, "gravity_deg is missing: give pressure_kpa, gravity_deg"),
        ({"pressure_kpa": [1.0, 2.0], "gravity_deg": [1.0, 2.0, 3.0]}, "have 2 and 3 values; give as many of each"),
        ({"pressure_kpa": 20.0, "gravity_deg": np.inf}, "gravity_deg holds 1 values that are not finite"),
        ({"pressure_kpa": 20.0, "gravity_deg": [[1.0]]}, r"gravity_deg has shape \(1, 1\).* in °"),
    ]:
        with pytest.raises(InputError, match=told):
            found.predict(point, asked)  # type: ignore[arg-type]
    with pytest.raises(TooFar, match="gravity_deg = 95 lies too far outside the trained -60 to 60 .* from -90 to 90"):
        found.predict(point, {"pressure_kpa": 20.0, "gravity_deg": 95.0})
    with pytest.raises(TooFar, match="70 kPa lies too far outside the trained 5 to 50 kPa"):
        found.predict(point, {"pressure_kpa": 70.0, "gravity_deg": 0.0})
    with pytest.warns(Outside, match="gravity_deg = 70 lies outside the trained -60 to 60: give values within them"):
        found.predict(point, {"pressure_kpa": [20.0, 10.0], "gravity_deg": [0.0, 70.0]})
    assert found.predict(point, {"pressure_kpa": 20.0, "gravity_deg": 95.0}, beyond=True).shape == (1, 2)
    with pytest.raises(InputError, match=r"ask surrogate\.holding\(gravity_deg=…\)"):
        found.pressure_for(curvature=1.0)
    with pytest.raises(TooFar, match="gravity_deg = 100"):
        found.holding(gravity_deg=100.0)
    with pytest.raises(InputError, match="gravity_deg is missing: give pressure_kpa, gravity_deg"):
        found.holding(wall_mm=1.0)
    with pytest.raises(InputError, match="save the one of all inputs"):
        found.holding(gravity_deg=1.0).save("a.pt")
    assert "gravity_deg from -60 to 60" in repr(found)


def test_terms_of_physics_know_the_pressure_alone(tmp_path: Path) -> None:
    data = joined()
    how = training(
        tmp_path, {"data": {}, "navier_cauchy": {}}, samples=Samples.of(data, np.arange(900)), scene=scene(data)
    )
    with pytest.raises(InputError, match="Loss navier_cauchy knows no other input than the pressure"):
        plugin("model", "mlp")(depth=1, width=4).fit(how)


def test_the_plain_form_holds_several_inputs_and_a_graph_does_not(tmp_path: Path) -> None:
    found = surrogate("pod")
    plain, *graphs = export(found, tmp_path)
    assert isinstance(plain, Form) and plain.difference_mm == 0
    assert len(graphs) == 2 and all("A graph takes the pressure alone" in str(reason) for reason in graphs)
    asked = {"pressure_kpa": [10.0, 20.0], "gravity_deg": 5.0}
    assert np.array_equal(load(plain.path).predict([[20.0, 5.0]], asked), found.predict([[20.0, 5.0]], asked))


def test_a_model_of_the_pressure_alone_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = joined()
    how = training(tmp_path, {"data": {}}, samples=Samples.of(data, np.arange(900)), scene=scene(data))
    monkeypatch.setattr(plugin("model", "pod"), "several_inputs", False)
    with pytest.raises(InputError, match="model=pod knows the pressure alone, and the data have pressure_kpa, grav"):
        trained(plugin("model", "pod")(), how)


def test_too_few_simulations_have_no_bars_and_one_alone_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    data = Dataset.joined([turned(-30.0), turned(30.0)], gravity_deg=[-30.0, 30.0])
    points = np.sort(np.random.default_rng(0).choice(data.displacements[..., 0].size, 600, replace=False))
    how = training(tmp_path, {"data": {}}, samples=Samples.of(data, points), scene=scene(data))
    found = trained(plugin("model", "finite_element")(degree=3), how)
    assert found.error_bar([[20.0, 5.0]], {"pressure_kpa": 20.0, "gravity_deg": 0.0}) is None
    assert "2 simulations are too few to tell how far the model errs between them" in caplog.text
    alone = training(tmp_path, {"data": {}}, samples=Samples.of(data, np.arange(900)), scene=scene(data))
    with pytest.raises(InputError, match="gravity_deg is -30 at all training points, so that nothing tells what it"):
        trained(plugin("model", "finite_element")(), alone)


@pytest.mark.parametrize("name", ["pod", "gaussian_process"])
def test_a_file_of_other_inputs_than_its_own_is_refused(name: str, tmp_path: Path) -> None:
    found = surrogate(name)
    found.save(tmp_path / "s.pt")
    about = archive.read(tmp_path / "s.pt")
    state, face = about.pop("state"), about.pop("face")
    del about["record"]["ranges"]["gravity_deg"]
    archive.write(tmp_path / "less.pt", about, state=state, face=face)
    with pytest.raises(InputError, match="does not hold the weights that its model needs"):
        load(tmp_path / "less.pt")
