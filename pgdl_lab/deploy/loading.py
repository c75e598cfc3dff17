"""Loading a surrogate: data only, and only what its model needs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.deploy.face_mesh import FaceMesh
from pgdl_lab.deploy.shapes import FLOATS, INDICES, Shapes, require
from pgdl_lab.errors import InputError
from pgdl_lab.surrogate import FORMAT, VERSION, Face, Record, Surrogate

FACE: Shapes = {"points_mm": (FLOATS, "N", 2), "triangles": (INDICES, "T", 3), "base": (INDICES, "B")}


def load(path: str | Path, outside: str = "warn") -> Surrogate:
    """Read a surrogate that `Surrogate.save` or `task=export` wrote; never runs code from the file.

    A .npz needs NumPy alone, a .pt also what its model needs: torch if it is a network.

    Parameters
    ----------
    path
        A surrogate.pt or a surrogate.npz.
    outside
        See `Surrogate`.

    Raises
    ------
    InputError
        When there is no such file, it is damaged, or it is no surrogate of a known version and model.
    """
    path = Path(path)
    if outside not in ("warn", "raise", "ignore"):
        raise InputError(f"outside is '{outside}'; it must be warn, raise or ignore.")
    content = _content(path)
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise InputError(f"{path} is not a surrogate of pgdl_lab; give the surrogate.pt of a run.")
    if content.get("version") != VERSION:
        raise InputError(
            f"{path} has format version {content.get('version')}, but this pgdl_lab reads {VERSION}; train it again."
        )
    try:
        surrogate = _restored(path, content)
        if not _works(surrogate):
            raise ValueError("it gives no finite numbers")
    except InputError:
        raise
    except Exception as error:  # arrays that do not fit make models trip in many ways
        raise InputError(f"{path} does not hold the weights that its model needs; train it again.") from error
    surrogate.outside = outside
    return surrogate


def _content(path: Path) -> Any:
    if path.suffix == ".npz":
        from pgdl_lab.deploy.numpy_form import read

        return read(path)
    from pgdl_lab.deploy.archive import read_archive

    return read_archive(path, "surrogate")


def _restored(path: Path, content: Mapping[str, Any]) -> Surrogate:
    face = content["face"] and _face(content["face"])
    if path.suffix == ".npz":
        from pgdl_lab.deploy import numpy_form

        return numpy_form.restored(content, face)
    from omegaconf import OmegaConf

    from pgdl_lab.registry import discover, restored

    discover("model")
    model: Any = OmegaConf.to_object(restored("model", content["model"]))
    surrogate: Surrogate = model.restore(content["state"], Record(**content["record"], face=face))
    return surrogate


def _face(arrays: Mapping[str, NDArray[Any]]) -> Face:
    require(arrays, FACE)
    mesh = _mesh(arrays)
    base = arrays["base"]
    if len(base) < 2 or not 0 <= base.min() <= base.max() < len(mesh.points_mm):
        raise ValueError("a point is missing")
    return Face(mesh, base)


def _mesh(arrays: Mapping[str, NDArray[Any]]) -> FaceMesh:
    """The triangulated body among `arrays`, in which every point can be located."""
    points, triangles = arrays["points_mm"], arrays["triangles"]
    if not np.isfinite(points).all() or not 0 <= triangles.min() <= triangles.max() < len(points):
        raise ValueError("a point is missing")
    mesh = FaceMesh(points, triangles)
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
    low, high = ranges["pressure_kpa"]
    point = np.zeros((1, 2)) if surrogate.record.face is None else surrogate.face.mesh.points_mm[:1]
    answers, bars = surrogate.probe(point).values(np.array([low, high])), surrogate.bars(point, np.array([low, high]))
    if bars is not None and not (bars.shape == (2, 1) and np.isfinite(bars).all()):
        return False
    return answers.shape == (2, 1, 2) and bool(low <= high and np.isfinite(answers).all())
