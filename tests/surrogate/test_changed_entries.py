"""Surrogate files whose archive is sound, but one entry is another: refused when they are read, or they work."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors import safe_open

import pgdl_lab
from pgdl_lab.core.errors import InputError
from pgdl_lab.surrogate.archive import safetensors
from tests.surrogate.test_other_machines import STORED

CASES = 100
HELD = ("bool", "int32", "int64", "float32", "float64")  # of all that the tests put in, what the format can hold
STRANGE: tuple[Any, ...] = (None, -1, 1e308, float("nan"), "x", [], {}, [[1]], True, "9" * 30, [1.0], [5, 1], [None, 2])


def changed_array(rng: np.random.Generator, array: NDArray[Any]) -> NDArray[Any]:
    """Of another shape or type, or with another number in it."""
    other = array.copy()
    if other.size:
        numbers = (np.nan, np.inf, 1e308, -1.0, 0.0) if array.dtype.kind == "f" else (-1, 0, 10**6, 2**40)
        with np.errstate(over="ignore"):
            other.flat[rng.integers(other.size)] = rng.choice(numbers)
    types = (np.float32, np.int64, np.int32, np.complex128, np.bool_)
    choices = [
        other,
        array.T,
        array[None],
        array.reshape(-1),
        np.zeros((), array.dtype),
        array.astype(rng.choice(types)),
    ]
    if array.ndim:
        choices += [array[:0], array[..., :-1], np.concatenate([array, array])]
    return choices[rng.integers(len(choices))]


def changed(rng: np.random.Generator, tree: Any) -> Any:
    """The same tree of entries, but one is missing, has another name or is something else."""
    if isinstance(tree, np.ndarray):
        return changed_array(rng, tree)
    if not isinstance(tree, dict) or not tree or rng.random() < 0.05:
        return STRANGE[rng.integers(len(STRANGE))]
    key, other = list(tree)[rng.integers(len(tree))], dict(tree)
    entry = other.pop(key)
    what = rng.random()
    if what > 0.15:
        other[key] = changed(rng, entry)
    elif what > 0.1:
        other[f"{key}x"] = entry
    return other


def entries(path: Path) -> dict[str, Any]:
    """What a file holds, by the libraries whose formats they are."""
    if path.suffix == ".npz":
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files if name != "about"}
            return {"about": json.loads(str(file["about"])), **arrays}
    with safe_open(path, framework="numpy") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # it is no mapping
        return {"about": json.loads(file.metadata()["about"]), **arrays}


def write(tree: Any, path: Path) -> None:
    members = tree if isinstance(tree, dict) else {"about": tree}
    arrays = {name: np.array(entry, order="C") for name, entry in members.items() if name != "about"}
    if path.suffix == ".npz":
        about = {"about": np.array(json.dumps(members["about"]))} if "about" in members else {}
        np.savez(path, **arrays, **about)
    else:
        held = {name: array for name, array in arrays.items() if array.dtype.name in HELD}
        path.write_bytes(safetensors(members.get("about"), held))


@pytest.mark.parametrize("name", ["modes.npz", "network.npz", "modes.pt"])
def test_a_changed_entry_is_refused_or_harmless(name: str, tmp_path: Path) -> None:
    whole, points = entries(STORED / name), np.load(STORED / "points_mm.npy")[:3]
    path, rng, refused = tmp_path / name, np.random.default_rng(0), 0
    for _ in range(CASES):
        write(changed(rng, whole), path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                surrogate = pgdl_lab.load(path)
            except InputError as error:
                assert "\n" not in str(error)
                refused += 1
                continue
            field = surrogate.predict(points, [1.0, 70.0], beyond=True)  # from here on nothing may trip
            assert field.shape == (2, 3, 2)
            surrogate.error_bar(points, 10.0)
            surrogate.at(points).slope(5.0)
            surrogate.pressure_for(tip=(80.0, -50.0))
            surrogate.pressure_for(curvature=-5.0)
    assert CASES / 4 < refused < CASES
