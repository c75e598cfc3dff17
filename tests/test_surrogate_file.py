"""The file of a surrogate: whole, from others, damaged, and where little is installed."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open

import pgdl_lab
from pgdl_lab.core.errors import InputError
from pgdl_lab.export import numpy_form
from pgdl_lab.surrogate import archive
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.conftest import CHECKOUT
from tests.surrogates import MODELS, trained
from tests.trainings import small


@pytest.fixture(scope="module", params=MODELS)
def surrogate(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    return trained(request.param, tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def linear(tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    return trained("pod", tmp_path_factory.mktemp("run"))


def test_round_trip_is_exact(surrogate: Surrogate, tmp_path: Path) -> None:
    path = tmp_path / "surrogate.pt"
    surrogate.save(path)
    again = pgdl_lab.load(path)
    points = small().domain.points_mm
    assert np.array_equal(again.predict(points, [5.0, 50.0]), surrogate.predict(points, [5.0, 50.0]))
    assert np.array_equal(again.error_bar(points, 5.0), surrogate.error_bar(points, 5.0))
    assert again.model == surrogate.model and again.record == surrogate.record
    assert [file.name for file in tmp_path.iterdir()] == ["surrogate.pt"]


def test_file_says_what_it_holds(surrogate: Surrogate, tmp_path: Path) -> None:
    surrogate.save(tmp_path / "surrogate.pt")
    with safe_open(tmp_path / "surrogate.pt", framework="numpy") as file:
        content = json.loads(file.metadata()["about"])
        assert {name.partition("/")[0] for name in file.keys()} == {"state", "face"}  # noqa: SIM118  # it is no mapping
    assert content["format"] == "pgdl_lab surrogate" and content["version"] == 3
    assert content["units"] == {"points": "mm", "pressure": "kPa", "displacement": "mm"}
    assert content["record"]["ranges"]["pressure_kpa"][1] == 50 and len(content["provenance_hash"]) == 64


def foreign_files(folder: Path, surrogate: Surrogate) -> dict[str, Path]:
    """Files that are no surrogates, by what is wrong with them."""
    names = (
        *("empty", "text", "tensor", "truncated", "version", "model", "state", "pickle", "nan", "shape", "face"),
        *("malicious", "numbers"),
    )
    paths = {name: folder / name for name in names}
    surrogate.save(paths["truncated"])
    about = archive.read(paths["truncated"])
    state, face = about.pop("state"), about.pop("face")
    first = next(name for name, array in state.items() if array.ndim == 2 and array.dtype.kind == "f")
    archive.write(paths["version"], {**about, "version": 1}, state=state, face=face)
    archive.write(paths["model"], {**about, "model": {"name": "oracle"}}, state=state, face=face)
    archive.write(paths["state"], about, face=face)
    archive.write(paths["nan"], about, state={**state, first: state[first] * np.nan}, face=face)
    archive.write(paths["shape"], about, state={**state, first: state[first][:, :-1]}, face=face)
    archive.write(paths["face"], about, state=state, face={**face, "base": np.array([10**9])})
    archive.write(paths["numbers"], {}, state=state)
    data = paths["truncated"].read_bytes()
    paths["truncated"].write_bytes(data[: len(data) // 2])
    paths["empty"].touch()
    paths["text"].write_text("surrogate")
    torch.save(torch.zeros(3), paths["tensor"])
    torch.save(Path("code"), paths["pickle"])
    torch.save({**about, "record": Malicious(folder)}, paths["malicious"])
    return paths


class Malicious:
    """A pickle of it makes a file `ran` when it is loaded."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.folder / "ran"),)


def test_other_files_are_refused_in_one_sentence(surrogate: Surrogate, tmp_path: Path) -> None:
    expected = {
        "version": "format version 1, but this pgdl_lab reads 3",
        "model": "was trained with the model 'oracle', which pgdl_lab does not ship.* Known models: body, .*pod",
        "state": "does not hold the weights",
        "nan": "does not hold the weights",
        "shape": "does not hold the weights",
        "face": "does not hold the weights",
        "numbers": "is not a surrogate",
        **dict.fromkeys(("tensor", "pickle", "malicious"), "by an earlier pgdl_lab as a pickle.*: train it again"),
    }
    for name, path in foreign_files(tmp_path, surrogate).items():
        with pytest.raises(InputError, match=expected.get(name, "is damaged or not a surrogate")) as caught:
            pgdl_lab.load(path)
        assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    assert not (tmp_path / "ran").exists()
    with pytest.raises(pickle.UnpicklingError):
        torch.load(tmp_path / "malicious", weights_only=True)
    small().save(tmp_path / "snapshots.h5")
    with pytest.raises(InputError, match="is no surrogate but an HDF5 file, such as the snapshots .*Dataset.load"):
        pgdl_lab.load(tmp_path / "snapshots.h5")
    with pytest.raises(InputError, match="No such file"):
        pgdl_lab.load(tmp_path / "nothing.pt")
    with pytest.raises(InputError, match="Is a directory"):
        pgdl_lab.load(tmp_path)
    with pytest.raises(InputError, match="/dev/zero cannot be read: it is a device"):
        pgdl_lab.load("/dev/zero")


@pytest.mark.parametrize("suffix", ["pt", "npz"])
def test_any_changed_byte_is_refused_or_harmless(linear: Surrogate, tmp_path: Path, suffix: str) -> None:
    whole = tmp_path / f"whole.{suffix}"
    linear.save(whole) if suffix == "pt" else numpy_form.write(linear, whole)
    data, path = whole.read_bytes(), tmp_path / f"changed.{suffix}"
    points = small().domain.points_mm
    truth = linear.predict(points, 20.0)
    rng = np.random.default_rng(0)
    for _ in range(150):
        changed = bytearray(data)
        kind = rng.integers(4)
        place = int(rng.integers(len(data)) if rng.random() < 0.5 else rng.integers(-2000, 2000))  # head and directory
        if kind == 0:
            changed[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del changed[place:]
        elif kind == 2:
            changed[place:place] = rng.bytes(int(rng.integers(1, 9)))
        else:
            changed = bytearray(rng.bytes(int(rng.integers(0, 500))))
        path.write_bytes(changed)
        try:
            surrogate = pgdl_lab.load(path)
        except InputError as refused:
            assert "\n" not in str(refused)
        else:  # a byte between the members
            assert np.array_equal(surrogate.predict(points, 20.0), truth)
            assert all(np.array_equal(array, linear.state()[name]) for name, array in surrogate.state().items())
            assert surrogate.record.provenance == linear.record.provenance


ROBOT = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Blocked())
import json, pgdl_lab
surrogate = pgdl_lab.load(sys.argv[1])
tip = surrogate.predict([surrogate.tip_mm], [10.0, 20.0])
answer = surrogate.pressure_for(tip=surrogate.tip_mm + tip[0, 0])
print(json.dumps([tip.tolist(), answer.kpa]))
"""
HEAVY = ["mlflow", "hydra", "optuna", "skfem", "lightning", "matplotlib", "meshio", "h5py", "pandas", "sklearn"]
BEYOND_NUMPY = [*HEAVY, "torch", "scipy", "omegaconf", "rich", "filelock", "yaml"]


@pytest.mark.parametrize(
    ("name", "suffix", "blocked"),
    [
        ("pod", "npz", BEYOND_NUMPY),
        ("mlp", "npz", BEYOND_NUMPY),
        ("pod", "pt", [*HEAVY, "torch"]),
        ("mlp", "pt", HEAVY),
    ],
)
def test_loads_where_little_is_installed(name: str, suffix: str, blocked: list[str], tmp_path: Path) -> None:
    surrogate = trained(name, tmp_path)
    path = tmp_path / f"surrogate.{suffix}"
    surrogate.save(path) if suffix == "pt" else numpy_form.write(surrogate, path)
    script = ROBOT.format(blocked=blocked)
    environment = {**os.environ, "PYTHONPATH": str(CHECKOUT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    tip, kpa = json.loads(done.stdout)
    exact = name == "pod"
    assert np.array(tip) == pytest.approx(
        surrogate.predict([surrogate.tip_mm], [10.0, 20.0]), abs=0 if exact else 1e-3, rel=0
    )
    assert kpa == pytest.approx(10.0, abs=1e-9 if exact else 1e-4)
