"""A trained model: predict, save, load."""

from __future__ import annotations

import hashlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from omegaconf import OmegaConf
from torch import Tensor

from pgdl_lab.errors import InputError
from pgdl_lab.model import Model
from pgdl_lab.registry import describe, discover
from pgdl_lab.registry import restored as node_of

FORMAT = "pgdl_lab surrogate"
VERSION = 1
UNITS = {"points": "mm", "pressure": "kPa", "displacement": "mm"}


@dataclass(frozen=True)
class Record:
    """What a surrogate remembers of its training (JSON types only).

    Attributes
    ----------
    ranges
        Least and greatest training value: "x_mm", "z_mm" and "pressure_kpa".
    provenance
        Where the training data come from.
    history
        Entries of the loss history: "epoch", "seconds", "lr", "raw/<loss>", "weighted/<loss>", "share/<loss>".
    """

    ranges: dict[str, list[float]]
    provenance: dict[str, Any]
    history: list[dict[str, float]] = field(default_factory=list)

    @property
    def provenance_hash(self) -> str:
        """SHA-256 of the provenance."""
        return hashlib.sha256(json.dumps(self.provenance, sort_keys=True).encode()).hexdigest()


class Surrogate(ABC):
    """The displacement of the side face as a function of place and pressure.

    Parameters
    ----------
    model
        The rule that made it.
    record
        What it remembers of its training.
    """

    def __init__(self, model: Model, record: Record) -> None:
        self.model = model
        self.record = record

    @abstractmethod
    def state(self) -> dict[str, Tensor]:
        """Everything that was learnt, as tensors on the CPU."""

    @abstractmethod
    def displacements(self, points_mm: NDArray[np.float64], pressures_kpa: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacements (P, N, 2) [mm] at checked points (N, 2) [mm] and pressures (P,) [kPa]."""

    def predict(self, points_mm: ArrayLike, pressure_kpa: ArrayLike) -> NDArray[np.float64]:
        """Displacement of points of the undeformed face.

        Parameters
        ----------
        points_mm
            (N, 2), x and z of the undeformed points [mm].
        pressure_kpa
            A number or (P,) [kPa].

        Returns
        -------
        (N, 2) float64 for one pressure, (P, N, 2) float64 for several: u_x and u_z [mm].

        Raises
        ------
        InputError
            When a shape is wrong, a value is not a finite number, or a point lies outside the body of a model that
            knows the body.
        """
        points, pressures = _query(points_mm, pressure_kpa)
        field = self.displacements(points, np.atleast_1d(pressures))
        return field if pressures.ndim else field[0]

    def bars(self, points_mm: NDArray[np.float64], pressures_kpa: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Error bars (P, N) [mm] at checked points (N, 2) [mm] and pressures (P,) [kPa]; None: has none."""
        return None

    def error_bar(self, points_mm: ArrayLike, pressure_kpa: ArrayLike) -> NDArray[np.float64] | None:
        """What the model itself expects to err by: |error| of u_x, and of u_z, stays below it in 95 of 100 cases.

        Parameters
        ----------
        points_mm, pressure_kpa
            See `predict`.

        Returns
        -------
        (N,) float64 for one pressure, (P, N) float64 for several [mm]; None of a model that cannot tell.

        Raises
        ------
        InputError
            See `predict`.
        """
        points, pressures = _query(points_mm, pressure_kpa)
        bars = self.bars(points, np.atleast_1d(pressures))
        return bars if bars is None or pressures.ndim else bars[0]

    def save(self, path: str | Path) -> None:
        """Write the surrogate to `path`; the file appears there only when it is complete."""
        path = Path(path)
        content = {
            "format": FORMAT,
            "version": VERSION,
            "model": describe(self.model),
            "state": self.state(),
            "record": asdict(self.record),
            "provenance_hash": self.record.provenance_hash,
            "units": UNITS,
        }
        write_atomically(content, path)


def write_atomically(content: Any, path: Path) -> None:
    """`torch.save` to a temporary name in the same folder, then rename."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        torch.save(content, temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def load(path: str | Path) -> Surrogate:
    """Read a surrogate that `Surrogate.save` wrote; never runs code from the file.

    Raises
    ------
    InputError
        When there is no such file, it is damaged, or it is no surrogate of a known version and model.
    """
    path = Path(path)
    content = read_safely(path, "surrogate")
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise InputError(f"{path} is not a surrogate of pgdl_lab; give the surrogate.pt of a run.")
    if content.get("version") != VERSION:
        raise InputError(
            f"{path} has format version {content.get('version')}, but this pgdl_lab reads {VERSION}; train it again."
        )
    discover()
    try:
        model: Any = OmegaConf.to_object(node_of("model", content["model"]))
        restored: Surrogate = model.restore(content["state"], Record(**content["record"]))
        return restored
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path} does not hold the weights that its model needs; train it again.") from error


def read_safely(path: Path, what: str) -> Any:
    """`torch.load` of plain data and tensors, onto the CPU.

    Raises
    ------
    InputError
        When there is no such file, or it is damaged or foreign.
    """
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise InputError(f"The {what} {path} cannot be read: {error.strerror}.") from error
    except Exception as error:  # the unpickler trips over foreign bytes in many ways
        raise InputError(f"{path} is damaged or not a {what} of pgdl_lab; give another file or train again.") from error


def _query(points_mm: ArrayLike, pressure_kpa: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (N, 2) and pressures () or (P,), checked."""
    points = _numbers(points_mm, "points_mm")
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"points_mm has shape {points.shape}; it must be (N, 2): x and z of N points in mm.")
    pressures = _numbers(pressure_kpa, "pressure_kpa")
    if pressures.ndim > 1:
        raise InputError(f"pressure_kpa has shape {pressures.shape}; it must be a number or (P,), in kPa.")
    return points, pressures


def _numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} cannot be read as numbers ({error}).") from error
    if not np.isfinite(numbers).all():
        raise InputError(f"{name} holds {int((~np.isfinite(numbers)).sum())} values that are not finite; remove them.")
    return numbers
