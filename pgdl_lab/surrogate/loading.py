"""Loading a surrogate: data only, and only what its model needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.simplices import SimplexMesh
from pgdl_lab.surrogate.archive import read, reason
from pgdl_lab.surrogate.network import NetworkSurrogate
from pgdl_lab.surrogate.nodal_surrogate import NodalSurrogate
from pgdl_lab.surrogate.process_surrogate import ProcessSurrogate
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.shapes import FLOATS, INDICES, Shapes, require
from pgdl_lab.surrogate.surrogate import FORMAT, VERSION, Surrogate

SIMPLEX = {2: "triangle", 3: "tetra"}  # by the number of dimensions

TABLE, TABLE_PER_TRIANGLE = 2**20, 100  # entries of `SimplexMesh.grid` that are allowed; fingers have 10 per triangle

PLAIN: dict[str, Callable[[Mapping[str, Any], Record, Mapping[str, NDArray[Any]]], Surrogate]] = {
    "nodal": NodalSurrogate,
    "process": ProcessSurrogate,
    "network": NetworkSurrogate,
}
"""Surrogates that NumPy alone evaluates, by the "kind" of their file."""

FACE: Shapes = {"points_mm": (FLOATS, "N", "d"), "triangles": (INDICES, "T", "c"), "base": (INDICES, "B")}


def load(path: str | Path, outside: str = "warn") -> Surrogate:
    """Read a surrogate that `Surrogate.save` or `task=export` wrote: data only, no code runs that a file could choose.

    The file is of a format that holds nothing but numbers and text, and takes memory as it is large: neither what it
    says of its arrays nor its settings can ask for more. Its model must be one of those that the lab ships, or one that
    the program has registered before: no plugin of the working directory, of PGDL_LAB_ROOT or of another package is
    imported because a file names it. `pgdl_lab.discover()` imports those, as the command line does.

    A .npz needs NumPy alone, a .pt also safetensors, OmegaConf and what its model needs: torch if it is a network.

    Parameters
    ----------
    path
        A surrogate.pt or a surrogate.npz.
    outside
        See `Surrogate`.

    Raises
    ------
    InputError
        When there is no such file, it is damaged, it is no surrogate of a known version and model, or asks for more
        memory than it explains.
    """
    path = Path(path)
    if outside not in ("warn", "raise", "ignore"):
        raise InputError(f"outside is '{outside}'; it must be warn, raise or ignore.")
    content = read(path)
    if content.get("format") != FORMAT:
        raise InputError(f"{path} is not a surrogate of pgdl_lab; give the surrogate.pt of a run.")
    if content.get("version") != VERSION:
        raise InputError(
            f"{path} has format version {content.get('version')}, but this pgdl_lab reads {VERSION}; train it again."
        )
    try:
        surrogate = _restored(path, content)
        if not _works(surrogate):
            raise ValueError("it gives no finite numbers")
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path} cannot be restored: {error}") from error
    except Exception as error:  # arrays that do not fit make models trip in many ways
        told = f" ({reason(error)})" if isinstance(error, ValueError) else ""
        raise InputError(f"{path} does not hold the weights that its model needs{told}; train it again.") from error
    surrogate.outside = outside
    return surrogate


def _restored(path: Path, content: Mapping[str, Any]) -> Surrogate:
    domain = _domain(content["face"]) if content["face"] else None
    if "kind" in content:
        record = Record(content["ranges"], content["provenance"], domain=domain)
        return PLAIN[content["kind"]](content["model"], record, content["state"])
    from omegaconf import OmegaConf

    from pgdl_lab.core.paths import OWN_PLUGINS
    from pgdl_lab.core.registry import discover_shipped, names, require_values, restored

    require_values(content["model"], path)
    name = content["model"]["name"]
    if name not in names("model"):
        discover_shipped("model")
    if name not in names("model"):
        raise InputError(
            f"{path} was trained with the model '{name}', which pgdl_lab does not ship, and no file alone can make a "
            "plugin run: if you trust it, call pgdl_lab.discover() before, which imports those in "
            f"{OWN_PLUGINS} and of installed packages. Known models: {', '.join(names('model'))}."
        )
    model: Any = OmegaConf.to_object(restored("model", content["model"]))
    surrogate: Surrogate = model.restore(content["state"], Record(**content["record"], domain=domain))
    return surrogate


def _domain(arrays: Mapping[str, NDArray[Any]]) -> Domain:
    require(arrays, FACE)
    mesh = _mesh(arrays)
    base = arrays["base"]
    if len(base) < 2 or not 0 <= base.min() <= base.max() < len(mesh.points_mm):
        raise ValueError("a point is missing")
    return Domain(mesh.points_mm, mesh.simplices, SIMPLEX[mesh.points_mm.shape[1]], base)


def _mesh(arrays: Mapping[str, NDArray[Any]]) -> SimplexMesh:
    """The triangulated body among `arrays`, in which every point can be located."""
    points, triangles = arrays["points_mm"], arrays["triangles"]
    if points.shape[1] not in SIMPLEX or triangles.shape[1] != points.shape[1] + 1:
        raise ValueError(f"points_mm is {points.shape} and triangles is {triangles.shape}")
    if not np.isfinite(points).all() or not 0 <= triangles.min() <= triangles.max() < len(points):
        raise ValueError("a point is missing")
    mesh = SimplexMesh(points, triangles)
    entries, most = mesh.table_entries, max(TABLE, TABLE_PER_TRIANGLE * len(triangles))
    if entries > most:
        raise ValueError(f"to look a point up in its mesh would take {entries:,} entries, and {most:,} are allowed")
    if not len(mesh.outline) or not np.isfinite(mesh.affine[1]).all():
        raise ValueError("the triangles are no body")
    return mesh


def _works(surrogate: Surrogate) -> bool:
    """Whether the state is as it must be, all numbers are finite and two questions are answered."""
    state = surrogate.state()
    require(state, surrogate.shapes)
    if not all(np.isfinite(array).all() for array in state.values()):
        return False
    if "triangles" in state:
        _mesh(state)
    ranges = {name: (float(low), float(high)) for name, (low, high) in surrogate.record.ranges.items()}
    if not all(np.isfinite(bounds).all() for bounds in ranges.values()):
        return False
    low, high = np.array([ranges[name] for name in surrogate.inputs]).T
    ends = np.array([low, high]) if len(low) > 1 else np.concatenate([low, high])
    point = surrogate.domain.points_mm[:1] if surrogate.record.domain else np.zeros((1, surrogate.dimension))
    answers, bars = surrogate.probe(point).values(ends), surrogate.bars(point, ends)
    if bars is not None and not (bars.shape == (2, 1) and np.isfinite(bars).all()):
        return False
    return answers.shape == (2, *point.shape) and bool((low <= high).all() and np.isfinite(answers).all())
