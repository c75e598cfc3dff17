"""The dataset: displacements of the side face at rising pressures, and its HDF5 file."""

from __future__ import annotations

import html
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.hdf5 import require_contained
from pgdl_lab.core.heard import WARNINGS
from pgdl_lab.core.plotting import picture, plot_face

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMAT = "pgdl_lab snapshots"
VERSION = 1
BUSY_S = 10.0  # for which another program may write to a file
GLANCE_S = 0.2


class DamagedSnapshots(LabError):
    """A file that does not hold snapshots, or not whole."""


@dataclass(frozen=True)
class Observation:
    """What of a simulation is kept.

    Attributes
    ----------
    snapshots
        Number of equal pressure sub-steps from zero (excluded) to the highest pressure (included).
    points
        Number of points of the side face.
    """

    snapshots: int = 100
    points: int = 4439

    def __post_init__(self) -> None:
        if self.snapshots < 1:
            raise InputError(f"observation.snapshots is {self.snapshots}; at least 1 pressure must be observed.")
        if self.points < 4:
            raise InputError(f"observation.points is {self.points}; at least 4 points are needed to cover a face.")

    def pressures_kpa(self, max_kpa: float) -> NDArray[np.float64]:
        """Observed pressures (P,) [kPa] up to and including `max_kpa` [kPa]."""
        return max_kpa * np.arange(1, self.snapshots + 1) / self.snapshots


@dataclass(frozen=True)
class Body:
    """The whole simulated body at the pressures that were solved for.

    Attributes
    ----------
    positions
        (M, 3) float64, undeformed nodes [mm].
    cells
        (E, A) int64, nodes of each element in the order of VTK.
    cell_type
        Name of the element in meshio.
    pressures_kpa
        (K,) float64, rising from zero [kPa].
    displacements
        (K, M, 3) float64 [mm].
    """

    positions: NDArray[np.float64]
    cells: NDArray[np.int64]
    cell_type: str
    pressures_kpa: NDArray[np.float64]
    displacements: NDArray[np.float64]

    def fits(self) -> bool:
        """Whether the arrays fit together."""
        nodes = len(self.positions)
        return (
            self.positions.shape == (nodes, 3)
            and self.cells.ndim == 2
            and _within(self.cells, nodes)
            and self.pressures_kpa.ndim == 1
            and self.displacements.shape == (len(self.pressures_kpa), nodes, 3)
        )


@dataclass(frozen=True)
class Snapshots:
    """Displacements of N points of the side face at P pressures.

    Attributes
    ----------
    points
        (N, 2) float64, x and z of the undeformed points [mm].
    triangles
        (T, 3) int64, a triangulation of the undeformed face on these points.
    base
        (B,) int64, points of the base line, ordered from the root to the tip.
    clamp
        (C,) int64, points that are held fixed.
    pressures_kpa
        (P,) float64, rising [kPa].
    displacements
        (P, N, 2) float64, u_x and u_z [mm].
    body
        The whole body at the equilibria that were solved for; None where the model has no body.
    provenance
        Finger, mesh, material, solver, versions: everything needed to say where the numbers come from (JSON types
        only); "warnings" are sentences on what may be wrong with them.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    base: NDArray[np.int64]
    clamp: NDArray[np.int64]
    pressures_kpa: NDArray[np.float64]
    displacements: NDArray[np.float64]
    body: Body | None = None
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def warnings(self) -> list[str]:
        """What the simulation warned of, in sentences."""
        return list(self.provenance.get(WARNINGS, ()))

    def plot(self, pressure_kpa: float, axes: Axes | None = None) -> Axes:
        """Draw the bent side face over its shape at rest.

        Parameters
        ----------
        pressure_kpa
            The snapshot that is nearest to it is drawn [kPa].
        axes
            Where to draw, by default in a new figure of pyplot.

        Raises
        ------
        InputError
            When the pressure lies outside those of the snapshots.
        """
        known = self.pressures_kpa
        if not 0 <= pressure_kpa <= known[-1]:
            raise InputError(
                f"pressure_kpa is {pressure_kpa:g}; these snapshots go from {known[0]:g} to {known[-1]:g} kPa."
            )
        nearest = int(np.abs(known - pressure_kpa).argmin())
        title = f"{self._finger} at {known[nearest]:g} kPa"
        return plot_face(self.points, self.triangles, self.base, self.displacements[nearest], title, axes)

    def __repr__(self) -> str:
        pressures, points = self.displacements.shape[:2]
        fem = self.provenance.get("fem", {}).get("name", "unknown elements")
        return (
            f"<Snapshots of {self._finger} by {fem}: {points:,} points of its side face at {pressures} pressures up to "
            f"{self.pressures_kpa[-1]:g} kPa>"
        )

    @property
    def _finger(self) -> str:
        return str(self.provenance.get("finger", {}).get("name", "a finger"))

    def _repr_html_(self) -> str:
        """A sentence and a picture, for notebooks."""
        told = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in [repr(self)[1:-1], *self.warnings])
        return told + picture(lambda axes: self.plot(float(self.pressures_kpa[-1]), axes), "the bent side face")

    def save(self, path: Path) -> None:
        """Write an HDF5 file; `path` appears only when the file is whole."""
        with writing(path) as file:
            file.attrs.update(format=FORMAT, version=VERSION, provenance=json.dumps(self.provenance))
            _write(file, self)
            if self.body is not None:
                _write(file.create_group("body"), self.body)

    @classmethod
    def load(cls, path: Path) -> Snapshots:
        """Read what `save` wrote; nothing in the file is ever run as code.

        Raises
        ------
        DamagedSnapshots
            When the file is truncated, altered or not one of ours; the message says which.
        LabError
            When it cannot be opened now.
        """
        try:
            with _opened(path) as file:
                require_contained(file)
                if file.attrs.get("format") != FORMAT:
                    raise DamagedSnapshots(f"{path} is an HDF5 file, but does not hold snapshots of pgdl_lab.")
                if file.attrs["version"] != VERSION:
                    raise DamagedSnapshots(
                        f"{path} has version {file.attrs['version']} of the format, but this is version {VERSION}; "
                        "delete it to compute it again."
                    )
                body = _read(file["body"], Body) if "body" in file else None
                snapshots = cls(body=body, provenance=json.loads(file.attrs["provenance"]), **_arrays(file, cls))
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise DamagedSnapshots(
                f"{path} is no readable snapshot file, it may be truncated or foreign ({error})."
            ) from error
        snapshots._check(path)
        return snapshots

    def _check(self, path: Path) -> None:
        nodes, pressures = len(self.points), len(self.pressures_kpa)
        fits = (
            self.points.shape == (nodes, 2)
            and self.triangles.shape[1:] == (3,)
            and self.pressures_kpa.ndim == self.base.ndim == self.clamp.ndim == 1
            and self.displacements.shape == (pressures, nodes, 2)
            and all(_within(index, nodes) for index in (self.triangles, self.base, self.clamp))
            and all(np.isfinite(array).all() for array in (self.points, self.pressures_kpa, self.displacements))
            and (self.body is None or self.body.fits())
            and isinstance(self.provenance, dict)
        )
        if not fits:
            raise DamagedSnapshots(f"{path} holds arrays that do not fit together; delete it to compute it again.")


@contextmanager
def writing(path: Path) -> Iterator[Any]:
    """An open HDF5 file that appears at `path` when it is whole.

    It is made in memory: where a disk is full, HDF5 ends the whole process.
    """
    import h5py

    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        yield file
        file.flush()
        image = file.id.get_file_image()
    with replacing(path) as temporary:
        temporary.write_bytes(image)


def _opened(path: Path) -> Any:
    """The open HDF5 file, after a while if another program writes to it."""
    import h5py

    until = time.monotonic() + BUSY_S
    while True:
        try:
            return h5py.File(path, "r")
        except BlockingIOError as error:
            if time.monotonic() > until:
                raise LabError(
                    f"{path} is held by another program that may write to it, such as a viewer of HDF5 files or a "
                    "Python session: close it there."
                ) from error
        except OSError as error:
            if error.errno is None:  # HDF5 itself, about what is in the file
                raise
            raise LabError(
                f"{path} cannot be opened ({os.strerror(error.errno)}): check the file and who may read it."
            ) from error
        time.sleep(GLANCE_S)


def _within(index: NDArray[Any], nodes: int) -> bool:
    return index.size == 0 or bool(0 <= index.min() <= index.max() < nodes)


def _array_names(cls: type) -> list[str]:
    return [name for name, hint in get_type_hints(cls).items() if getattr(hint, "__origin__", None) is np.ndarray]


def _write(group: Any, record: Snapshots | Body) -> None:
    for name in _array_names(type(record)):
        array = getattr(record, name)
        # The checksum needs chunks; a chunk of one snapshot is what readers ask for.
        chunks = (1, *array.shape[1:]) if array.ndim == 3 else array.shape
        group.create_dataset(name, data=array, chunks=chunks if array.size else None, fletcher32=bool(array.size))
    if isinstance(record, Body):
        group.attrs["cell_type"] = record.cell_type


def _arrays(group: Any, cls: type) -> dict[str, NDArray[Any]]:
    arrays = {}
    for name in _array_names(cls):
        (wanted,) = get_args(get_args(get_type_hints(cls)[name])[1])
        arrays[name] = group[name][()]
        if arrays[name].dtype != wanted:
            raise ValueError(f"'{name}' is of type {arrays[name].dtype}")
    return arrays


def _read(group: Any, cls: type[Body]) -> Body:
    return cls(cell_type=str(group.attrs["cell_type"]), **_arrays(group, cls))
