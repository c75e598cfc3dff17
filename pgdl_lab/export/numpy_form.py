"""A surrogate as plain arrays in an .npz file: read and evaluated by NumPy alone.

Fields that are polynomials in the pressure give the same numbers to the last bit on every machine; networks as far as
its matrix products and exponentials agree.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.surrogate import archive
from pgdl_lab.surrogate.last_layer import STATE
from pgdl_lab.surrogate.network import ACTIVATIONS
from pgdl_lab.surrogate.nodal_surrogate import NodalSurrogate
from pgdl_lab.surrogate.process_surrogate import ProcessSurrogate
from pgdl_lab.surrogate.record import arrays_of
from pgdl_lab.surrogate.surrogate import FORMAT, UNITS, VERSION, Surrogate


def plain_state(surrogate: Surrogate) -> tuple[str, dict[str, NDArray[Any]]]:
    """Kind and arrays of the plain form of a surrogate.

    Raises
    ------
    InputError
        When its model has none.
    """
    if isinstance(surrogate, NodalSurrogate):
        return "nodal", surrogate.state()
    if isinstance(surrogate, ProcessSurrogate):
        return "process", surrogate.state()
    from pgdl_lab.learning.field import PlaneField  # torch is there, as the surrogate is one of torch

    field = getattr(surrogate, "field", None)
    if not isinstance(field, PlaneField) or surrogate.model["activation"] not in ACTIVATIONS:
        other = "ONNX file" if field is not None else "surrogate.pt"
        raise InputError(f"Model {surrogate.model['name']} has no plain NumPy form: use its {other}.")
    layers: dict[int, list[NDArray[Any]]] = {}
    bars: dict[str, NDArray[Any]] = {}
    for name, array in surrogate.state().items():
        if name.startswith(STATE):
            bars[name] = array
        else:
            layers.setdefault(int(name.split(".")[1]), []).append(array)
    plain = {
        str(number): np.stack([first, second]) if first.ndim == 1 else np.column_stack([first, second])
        for number, (_, (first, second)) in enumerate(sorted(layers.items()))
    }
    return "network", plain | bars


def write(surrogate: Surrogate, path: Path) -> None:
    """Write the plain form.

    Raises
    ------
    InputError
        See `plain_state`; also when the surrogate knows no face.
    """
    kind, arrays = plain_state(surrogate)
    record, domain = surrogate.record, surrogate.domain
    about = {
        "format": FORMAT, "version": VERSION, "kind": kind, "units": UNITS, "model": surrogate.model,
        "ranges": record.ranges, "provenance": record.provenance,
    }  # fmt: skip
    archive.write(path, about, state=arrays, face=arrays_of(domain))
