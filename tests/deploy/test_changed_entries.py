"""Surrogate files whose archive is sound, but one entry is another: refused when they are read, or they work."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import pgdl_lab
from pgdl_lab.errors import InputError
from tests.deploy.test_other_machines import STORED

CASES = 100
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


def plain(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return {"about": json.loads(str(file["about"])), **{name: file[name] for name in file.files if name != "about"}}


def write_plain(tree: Any, path: Path) -> None:
    entries = tree if isinstance(tree, dict) else {"about": tree}
    about = {"about": np.array(json.dumps(entries["about"]))} if "about" in entries else {}
    np.savez(path, **{**entries, **about})


def trained(path: Path) -> dict[str, Any]:
    def arrays(entry: Any) -> Any:
        if isinstance(entry, dict):
            return {name: arrays(each) for name, each in entry.items()}
        return entry.numpy() if isinstance(entry, torch.Tensor) else entry

    tree: dict[str, Any] = arrays(torch.load(path, weights_only=True))
    return tree


def write_trained(tree: Any, path: Path) -> None:
    def tensors(entry: Any) -> Any:
        if isinstance(entry, dict):
            return {name: tensors(each) for name, each in entry.items()}
        return torch.from_numpy(np.array(entry, order="C")) if isinstance(entry, np.ndarray) else entry

    torch.save(tensors(tree), path)


@pytest.mark.parametrize("name", ["modes.npz", "network.npz", "modes.pt"])
def test_a_changed_entry_is_refused_or_harmless(name: str, tmp_path: Path) -> None:
    read, write = (plain, write_plain) if name.endswith("npz") else (trained, write_trained)
    whole, points = read(STORED / name), np.load(STORED / "points_mm.npy")[:3]
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
