"""The whole body: from the simulation to a surrogate of all its nodes."""

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import torch

import pgdl_lab as lab
from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.assessment.figures import draw
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import TANGENT
from pgdl_lab.core.registry import plugin
from pgdl_lab.export.export import largest_difference_mm
from pgdl_lab.export.numpy_form import write
from pgdl_lab.export.torch_form import graph_of
from pgdl_lab.learning.in_space import require_in_space
from pgdl_lab.mechanics.derived import Mechanics
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.newton import solve
from pgdl_lab.mechanics.whole_body import followed, learnable, observed
from pgdl_lab.running import pipeline
from pgdl_lab.running.composing import experiment
from pgdl_lab.running.paraview import write_body
from pgdl_lab.surrogate.loading import load
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.fingers import solid
from tests.trainings import small
from tests.whole import PRESSURES, body, learnt, observed_body, simulated, train_points, whole_finger


@pytest.fixture(scope="module")
def surrogate(tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    return learnt(tmp_path_factory.mktemp("run"))


def test_body_tells_where_it_is_held_and_where_it_comes_from(tmp_path: Path) -> None:
    known, face = body(), simulated()
    points = known.domain.points_mm
    assert {*known.domain.clamp} == {*np.flatnonzero(points[:, 0] == 0)}
    assert not known.displacements[:, known.domain.clamp].any()
    line = points[known.domain.base]
    np.testing.assert_array_equal(line[:, 1:], np.broadcast_to([8.0, 0.0], line[:, 1:].shape))
    assert line[0, 0] == 0 and line[-1, 0] == points[:, 0].max() and (np.diff(line[:, 0]) > 0).all()
    assert len(line) == len(np.unique(points[(points[:, 1] == 8) & (points[:, 2] == 0), 0]))
    face.save(tmp_path / "data.h5")
    read = Dataset.load(tmp_path / "data.h5")
    assert read.body is not None and read.body.provenance == read.provenance != {}
    np.testing.assert_array_equal(read.body.fields[TANGENT], known.fields[TANGENT])
    read.provenance["later"] = 1
    assert read.body.provenance["later"] == 1


def test_body_at_the_observed_pressures_is_in_equilibrium() -> None:
    data = observed_body()
    np.testing.assert_array_equal(data.pressures_kpa, simulated().pressures_kpa)
    model = Mechanics.of(data).model
    between = np.abs(data.pressures_kpa[:, None] - body().pressures_kpa).min(axis=1) > 0.1
    assert between.any()
    place = int(np.flatnonzero(between)[0])
    acting = model.amplitudes(float(data.pressures_kpa[place]))
    true = solve(model.equilibrium, symmetric_solver(), data.displacements[place], acting, 1e-9).displacement
    assert np.abs(true - data.displacements[place]).max() < 2e-5  # fem.interpolation_mm is 1e-5


def test_face_and_body_are_the_same_finger() -> None:
    data, face = observed_body(), simulated()
    points = data.domain.points_mm
    outer = np.flatnonzero(points[:, 1] == points[:, 1].max())
    there = face.domain.interpolate(face.displacements, points[outer][:, [0, 2]])
    off = np.linalg.norm(there - data.displacements[:, outer][..., [0, 2]], axis=2)
    assert np.median(off) < 2e-3 * np.abs(face.displacements).max()


def test_a_body_without_tangents_is_known_at_its_equilibria_alone() -> None:
    bare = replace(body(), fields={"displacement_mm": body().displacements})
    at = followed(bare, body().pressures_kpa[[2, 4]])
    np.testing.assert_array_equal(at.displacements, body().displacements[[2, 4]])
    with pytest.raises(lab.InputError, match="pressures alone, without tangents"):
        followed(bare, np.array([0.123]))
    with pytest.raises(lab.InputError, match="of several simulations: follow each alone"):
        followed(Dataset.joined([body(), body()], gravity_deg=[0.0, 1.0]), np.array([5.0]))
    with pytest.raises(lab.InputError, match="this model knows no whole body: leave out observation.of=body"):
        observed(small(), lab.Observation(of="body"))
    with pytest.raises(lab.InputError, match="observation.of is 'all'; it must be face or body"):
        lab.Observation(of="all")


def test_one_simulation_serves_face_and_body(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fem = solid(element="hex27_p1")
    monkeypatch.setattr(type(fem), "simulate", lambda *_: simulated())
    face = lab.simulate(whole_finger(), fem, observation=PRESSURES)
    monkeypatch.setattr(type(fem), "simulate", None)
    data = lab.simulate(whole_finger(), fem, observation=replace(PRESSURES, of="body"))
    assert face.domain.points_mm.shape[1] == 2 and repr(data).endswith(
        "points of its body at 10 pressures up to 10 kPa>"
    )
    np.testing.assert_array_equal(data.displacements, observed_body().displacements)


def test_surrogate_of_the_body(surrogate: Surrogate, tmp_path: Path) -> None:
    data = observed_body()
    points = data.domain.points_mm
    off = np.linalg.norm(surrogate.predict(points, data.pressures_kpa) - data.displacements, axis=2)
    off.flat[train_points()] = np.nan
    assert np.sqrt(np.nanmean(off**2)) < 2e-3 * np.abs(data.displacements).max()
    assert np.abs(surrogate.predict(points[data.domain.clamp], 7.0)).max() < 1e-12
    corners = data.domain.mesh.simplices[::97]
    inside = points[corners].mean(axis=1)
    nodal = surrogate.predict(points, 7.3)
    np.testing.assert_allclose(surrogate.predict(inside, 7.3), nodal[corners].mean(axis=1), atol=1e-12)
    assert repr(surrogate).startswith("<surrogate pod of the whole body of finger pneunet: 1 to 10 kPa")
    assert set(surrogate.ranges) == {"x_mm", "y_mm", "z_mm", "pressure_kpa"}
    surrogate.save(tmp_path / "surrogate.pt")
    again = load(tmp_path / "surrogate.pt", outside="raise")
    np.testing.assert_array_equal(again.predict(inside, 7.3), surrogate.predict(inside, 7.3))
    np.testing.assert_array_equal(again.error_bar(inside, 7.3), surrogate.error_bar(inside, 7.3))
    np.testing.assert_array_equal(again.domain.mesh.simplices, data.domain.mesh.simplices)
    with pytest.raises(lab.InputError, match=r"such as x = 1, y = 50, z = 1 mm by"):
        again.predict([[1.0, 50.0, 1.0]], 7.0)
    with pytest.raises(lab.InputError, match=r"has shape \(1, 2\); it must be \(N, 3\): x, y and z of N points"):
        again.predict([[1.0, 1.0]], 7.0)


def test_error_bars_of_the_body(surrogate: Surrogate) -> None:
    data = observed_body()
    predicted = surrogate.predict(data.domain.points_mm, data.pressures_kpa)
    comparison = Comparison(
        data, predicted, train_points(), surrogate.error_bar(data.domain.points_mm, data.pressures_kpa)
    )
    bars = comparison.error_bar()
    assert bars is not None and min(bars[f"covered_{axis}"] for axis in "xyz") > 0.85
    assert set(comparison.mse_mm2()) == {*"xyz"} and set(comparison.extremes_mm()["fem"]) == {*"xyz"}


def test_pressure_for_a_place_of_the_tip_in_space(surrogate: Surrogate) -> None:
    tip = surrogate.tip_mm
    assert tip.shape == (3,)
    moved = tip + surrogate.predict([tip], 6.5)[0]
    assert surrogate.pressure_for(tip=tuple(moved)).kpa == pytest.approx(6.5, abs=1e-3)
    assert surrogate.pressure_for(tip=(None, None, float(moved[2]))).kpa == pytest.approx(6.5, abs=1e-3)
    with pytest.raises(lab.InputError, match=r"tip=\(x, y, z\) in mm"):
        surrogate.pressure_for(tip=(1.0, 2.0))


@pytest.mark.parametrize("model", ["finite_element", "gaussian_process", "mlp"])
def test_other_models_learn_the_body(model: str, tmp_path: Path) -> None:
    fields = {"gaussian_process": {"points": 200, "modes": 16}, "mlp": {"depth": 2, "width": 32}}.get(model, {})
    fitted = learnt(tmp_path, model, ("data", "boundary"), max_epochs=80, lr=1e-2, **fields)
    data = observed_body()
    error = fitted.predict(data.domain.points_mm, data.pressures_kpa, beyond=True) - data.displacements
    assert np.sqrt((error**2).mean()) < 0.5 * np.sqrt((data.displacements**2).mean())
    fitted.save(tmp_path / "s.pt")
    at = data.domain.points_mm[::9]
    np.testing.assert_array_equal(load(tmp_path / "s.pt").predict(at, 5.0), fitted.predict(at, 5.0))


def test_what_knows_the_side_face_alone_says_what_does_not(tmp_path: Path) -> None:
    able = "finite_element, gaussian_process, mlp, pod"
    with pytest.raises(lab.InputError, match=f"model=hybrid learns the side face alone: .* one of {able}, or"):
        learnt(tmp_path, "hybrid")
    losses = {name: plugin("loss", name)() for name in ("data", "traction", "navier_cauchy")}
    with pytest.raises(lab.InputError, match="Loss traction, navier_cauchy .* among boundary, data, equilibrium, or"):
        require_in_space(plugin("model", "mlp")(), losses)
    with pytest.raises(lab.InputError, match="model=body learns the side face alone"):
        pipeline.check(experiment(["observation.of=body", "model=body"]))
    pipeline.check(experiment(["observation.of=body", "model=pod", "split.points=900000"]))  # more than a face has
    with pytest.raises(lab.InputError, match="task=chart looks at the side face alone: leave out observation.of=body"):
        lab.Observation(of="body").require_face("task=chart")


def test_degree_in_space_can_be_chosen(surrogate: Surrogate, tmp_path: Path) -> None:
    assert len(surrogate.state()["spread"][0]) == 6
    assert len(learnt(tmp_path, degree=3, rounds=0).state()["spread"][0]) == 4


def test_exported_forms_of_a_body(surrogate: Surrogate, tmp_path: Path) -> None:
    write(surrogate, tmp_path / "surrogate.npz")
    assert largest_difference_mm(surrogate, load(tmp_path / "surrogate.npz", outside="ignore").predict) == 0
    graph = graph_of(surrogate)

    def predict(points_mm: np.ndarray, pressures_kpa: np.ndarray) -> np.ndarray:
        answer: np.ndarray = graph(torch.from_numpy(points_mm), torch.from_numpy(pressures_kpa)).numpy()
        return answer

    assert largest_difference_mm(surrogate, predict) < 1e-12
    assert np.isnan(predict(np.array([[1.0, 50.0, 1.0]]), np.array([5.0]))).all()


def test_pictures_from_the_side(surrogate: Surrogate, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    data = observed_body()
    axes = surrogate.plot(10.0, Figure().subplots())
    drawn = axes.lines[-1].get_xdata()
    base = data.domain.base
    expected = data.domain.points_mm[base, 0] + surrogate.predict(data.domain.points_mm[base], 10.0)[:, 0]
    np.testing.assert_allclose(drawn, expected)
    assert "data:image/png" in data._repr_html_()
    comparison = Comparison(data, surrogate.predict(data.domain.points_mm, data.pressures_kpa), train_points())
    names = {path.stem for path in draw(comparison, np.array([4, 9]), [], {}, tmp_path)}
    assert {"field_x", "field_y", "field_z", "base_lines"} <= names


def test_series_for_paraview_holds_both_fields_and_the_stress(surrogate: Surrogate, tmp_path: Path) -> None:
    whole = observed_body()
    data = Dataset.path(whole.domain, whole.pressures_kpa[-2:], whole.displacements[-2:], provenance=whole.provenance)
    series = write_body(surrogate, data, tmp_path)
    assert series.read_text().count("<DataSet") == 2
    mesh, predicted = meshio.read(tmp_path / "body_001.vtu"), surrogate.predict(data.domain.points_mm, 10.0)
    np.testing.assert_array_equal(mesh.cells[0].data, data.domain.cells)
    np.testing.assert_allclose(mesh.point_data["surrogate_mm"], predicted)
    np.testing.assert_allclose(mesh.point_data["difference_mm"], predicted - data.displacements[-1])
    assert (mesh.point_data["error_bar_mm"] >= 0).all()
    mechanics = Mechanics.of(surrogate)
    expected = mechanics.mean(mechanics.von_mises_mpa(predicted))
    np.testing.assert_allclose(mesh.cell_data["von_mises_mpa"][0], expected)


def test_a_body_of_elements_with_20_nodes_is_learnt_at_their_corners(tmp_path: Path) -> None:
    data = solid(element="hex20", edge_mm=8.0).simulate(whole_finger(), PRESSURES)
    assert data.body is not None and data.body.domain.cell_type == "hexahedron20"
    corners = learnable(data.body)
    assert corners.domain.fits() and corners.fits() and corners.domain.cell_type == "hexahedron"
    assert len(corners.domain.points_mm) < len(data.body.domain.points_mm)
    assert set(corners.domain.mesh.simplices.ravel()) == set(range(len(corners.domain.points_mm)))
    found = lab.train(data.body, lab.Pod(rounds=1), split=lab.RandomSplit(points=500))
    error = found.predict(corners.domain.points_mm, 10.0) - corners.displacements[-1]
    assert np.sqrt((error**2).mean()) < 0.05 * np.sqrt((corners.displacements[-1] ** 2).mean())
