"""Loading a surrogate: data only, and only what its model needs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.deploy.face_mesh import FaceMesh
from pgdl_lab.errors import InputError
from pgdl_lab.surrogate import FORMAT, VERSION, Face, Record, Surrogate


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
    points, triangles, base = arrays["points_mm"], arrays["triangles"], arrays["base"]
    for indices in (triangles, base):
        if not indices.size or not 0 <= indices.min() <= indices.max() < len(points):
            raise ValueError("a point is missing")
    return Face(FaceMesh(points, triangles), base)


def _works(surrogate: Surrogate) -> bool:
    """Whether all numbers are finite and one question is answered."""
    arrays = surrogate.state().values()
    if not all(np.isfinite(array).all() for array in arrays):
        return False
    ranges = surrogate.record.ranges
    if not all(len(bounds) == 2 and np.isfinite(bounds).all() for bounds in ranges.values()):
        return False
    point = np.zeros((1, 2)) if surrogate.record.face is None else surrogate.face.mesh.points_mm[:1]
    return surrogate.probe(point).value(1.0).shape == (1, 2)
