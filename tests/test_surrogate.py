from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import pgdl_lab
from pgdl_lab.errors import InputError
from pgdl_lab.registry import discover, plugin
from pgdl_lab.surrogate import Surrogate
from tests.trainings import small, training

discover()
MODELS = {
    "mlp": {"depth": 1, "width": 8, "interval": [0.0, 1.0]},
    "body": {"depth": 1, "width": 8, "modes": 16},
    "finite_element": {"degree": 3},
    "pod": {"degree": 3, "rounds": 1, "draws": 8},
    "hybrid": {"degree": 3, "inputs": 2, "rounds": 1, "folds": 2, "width": 4},
}


@pytest.fixture(scope="module", params=MODELS)
def surrogate(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    torch.set_num_threads(1)
    model = plugin("model", request.param)(**MODELS[request.param])
    trained = model.fit(training(tmp_path_factory.mktemp("run"), {"data": {}}, max_epochs=1))
    assert isinstance(trained, Surrogate)
    return trained


def test_one_pressure_gives_n_by_2_and_several_p_by_n_by_2(surrogate: Surrogate) -> None:
    points = small().points
    several = surrogate.predict(points, [10.0, 20.0, 60.0])
    assert several.shape == (3, len(points), 2) and several.dtype == np.float64
    assert surrogate.predict(points, 20) == pytest.approx(several[1], abs=1e-4)
    assert surrogate.predict(points[3:4], 20.0) == pytest.approx(several[1, 3:4], abs=1e-4)
    assert surrogate.predict(points, []).shape == (0, len(points), 2)


def test_error_bars_have_the_shape_of_the_question(surrogate: Surrogate) -> None:
    points = small().points
    several = surrogate.error_bar(points, [10.0, 60.0])
    if several is None:
        assert surrogate.error_bar(points[:3], 10.0) is None
        return
    assert several.shape == (2, len(points)) and (several > 0).all()
    assert surrogate.error_bar(points[:3], 60) == pytest.approx(several[1, :3])
    with pytest.raises(InputError, match="points_mm has shape"):
        surrogate.error_bar(points[0], 10.0)


@pytest.mark.parametrize(
    ("points", "kpa", "words"),
    [
        ([1.0, 2.0], 10.0, r"points_mm has shape \(2,\)"),
        ([[1.0, 2.0, 3.0]], 10.0, r"points_mm has shape \(1, 3\)"),
        ([[1.0, float("nan")]], 10.0, "points_mm holds 1 values that are not finite"),
        ([[1.0, 2.0]], float("inf"), "pressure_kpa holds 1 values"),
        ([[1.0, 2.0]], [[1.0]], r"pressure_kpa has shape \(1, 1\)"),
        ([["a", "b"]], 1.0, "points_mm cannot be read as numbers"),
    ],
)
def test_bad_input_is_named(surrogate: Surrogate, points: Any, kpa: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        surrogate.predict(points, kpa)


def test_round_trip_is_exact(surrogate: Surrogate, tmp_path: Path) -> None:
    path = tmp_path / "surrogate.pt"
    surrogate.save(path)
    again = pgdl_lab.load(path)
    points = small().points
    assert np.array_equal(again.predict(points, [5.0, 50.0]), surrogate.predict(points, [5.0, 50.0]))
    assert np.array_equal(again.error_bar(points, 5.0), surrogate.error_bar(points, 5.0))
    assert again.model == surrogate.model and again.record == surrogate.record
    assert [file.name for file in tmp_path.iterdir()] == ["surrogate.pt"]


def test_file_says_what_it_holds(surrogate: Surrogate, tmp_path: Path) -> None:
    surrogate.save(tmp_path / "surrogate.pt")
    content = torch.load(tmp_path / "surrogate.pt", weights_only=True)
    assert content["format"] == "pgdl_lab surrogate" and content["version"] == 1
    assert content["units"] == {"points": "mm", "pressure": "kPa", "displacement": "mm"}
    assert content["record"]["ranges"]["pressure_kpa"][1] == 50 and len(content["provenance_hash"]) == 64


def foreign_files(folder: Path, surrogate: Surrogate) -> dict[str, Path]:
    """Files that are no surrogates, by what is wrong with them."""
    names = ("empty", "text", "tensor", "truncated", "version", "model", "state", "pickle")
    paths = {name: folder / name for name in names}
    surrogate.save(paths["truncated"])
    content = torch.load(paths["truncated"], weights_only=True)
    torch.save({**content, "version": 99}, paths["version"])
    torch.save({**content, "model": {"name": "oracle"}}, paths["model"])
    torch.save({**content, "state": {}}, paths["state"])
    paths["truncated"].write_bytes(paths["truncated"].read_bytes()[:500])
    paths["empty"].touch()
    paths["text"].write_text("surrogate")
    torch.save(torch.zeros(3), paths["tensor"])
    torch.save(Path("code"), paths["pickle"])
    return paths


def test_other_files_are_refused_in_one_sentence(surrogate: Surrogate, tmp_path: Path) -> None:
    expected = {
        "version": "format version 99",
        "model": "no model 'oracle'",
        "state": "does not hold the weights",
        "tensor": "is not a surrogate",
    }
    for name, path in foreign_files(tmp_path, surrogate).items():
        with pytest.raises(InputError, match=expected.get(name, "is damaged or not a surrogate")) as caught:
            pgdl_lab.load(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="No such file"):
        pgdl_lab.load(tmp_path / "nothing.pt")


@pytest.mark.parametrize("name", ["body", "finite_element"])
def test_points_outside_the_body_are_refused(name: str, tmp_path: Path) -> None:
    model = plugin("model", name)(**MODELS[name])
    trained = model.fit(training(tmp_path, {"data": {}}, max_epochs=1))
    with pytest.raises(InputError, match="outside the undeformed body"):
        trained.predict([[11.0, 15.0]], 10.0)
