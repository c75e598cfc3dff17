"""The converged reference: Richardson extrapolation from two meshes, with what is left uncertain.

How much that is shows on a third mesh with twice the edges of the coarser one: errors that shrink by a factor from mesh
to mesh leave the rest of a geometric series. They need not: where the walls get a second layer of elements, they may
change sign instead (benchmarks/reference.py).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe, field_names, plugin
from pgdl_lab.mechanics.elements import ELEMENTS
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.running.cache import simulate

Array = NDArray[np.float64]

ORDER = 3
"""Order of convergence that is extrapolated with, unless the element has another: the element chart
(benchmarks/elements.py) shows 3.4 and 4.6."""
SHRINKING = 1 / 3, 1 / 2
"""Least and largest factor from mesh to mesh that is believed: they leave half and all of the last distance."""


@dataclass(frozen=True)
class Errors:
    """How far displacements are from others, over points and pressures.

    Attributes
    ----------
    rms_mm, largest_mm
        Root mean square and largest length of the difference [mm].
    tip_mm
        Largest length of the difference at the end of the base line [mm].
    """

    rms_mm: float
    largest_mm: float
    tip_mm: float

    @classmethod
    def of(cls, difference: Array, tip: int, counted: NDArray[np.bool_] | None = None) -> "Errors":
        """Of `difference` (P, N, 2) [mm] over the points `counted` (P, N), or over all; `tip` is a point's index."""
        length = np.linalg.norm(difference, axis=2)
        among = length if counted is None else length[counted]
        return cls(float(np.sqrt((among**2).mean())), float(among.max()), float(length[:, tip].max()))


@dataclass(frozen=True)
class Reference:
    """Displacements that a chart's methods are measured against.

    Attributes
    ----------
    coarser
        A simulation on a mesh with twice the edges of `coarse`; None: there is none.
    coarse, fine
        The two simulations, the second on a mesh with half the edges.
    edges_mm
        Their longest edges [mm].
    paths
        Their files, whose names tell everything that determines them.
    order
        Order of convergence of their element.
    """

    coarser: Dataset | None
    coarse: Dataset
    fine: Dataset
    edges_mm: tuple[float, float]
    paths: tuple[Path, Path]
    order: int = ORDER

    @property
    def displacements(self) -> Array:
        """Extrapolated displacements (P, N, 2) [mm]."""
        return self.fine.displacements + self._step / (2**self.order - 1)

    @property
    def uncertainty(self) -> Errors:
        """What the reference itself may err by."""
        factor = max(SHRINKING)
        if self.coarser is not None:
            before = np.linalg.norm(self.coarse.displacements - self.coarser.displacements)
            factor = float(np.clip(np.linalg.norm(self._step) / max(before, np.finfo(float).tiny), *SHRINKING))
        return Errors.of(self._step * factor / (1 - factor), self.tip)

    @property
    def tip(self) -> int:
        """Index of the end of the base line."""
        return int(self.fine.domain.base[-1])

    @property
    def pressures_kpa(self) -> Array:
        """Where errors are judged (P,) [kPa]."""
        return self.fine.pressures_kpa

    @property
    def _step(self) -> Array:
        return self.fine.displacements - self.coarse.displacements

    def errors(self, displacements: Array, counted: NDArray[np.bool_] | None = None) -> Errors:
        """Total errors of `displacements` (P, N, 2) [mm], over all points or those `counted` (P, N)."""
        return Errors.of(displacements - self.displacements, self.tip, counted)

    def among(self, pressures_kpa: Array) -> NDArray[np.int64]:
        """Indices (P,) of the judged pressures among `pressures_kpa` (Q,) [kPa], which hold them all."""
        return np.abs(pressures_kpa[:, None] - self.pressures_kpa).argmin(axis=0)


def find_reference(finger: Finger, description: dict[str, Any], observation: Observation, folder: Path) -> Reference:
    """Simulate `finger` on three meshes, or take what is in `folder`.

    Parameters
    ----------
    description
        Name and fields of the finite-element model, with `edge_mm` of the coarser of the two extrapolated from.

    Raises
    ------
    InputError
        When the model has no meshes to choose from, or the finger is given by one mesh alone.
    SimulationStopped
        When the finger cannot bear the highest pressure.
    """
    fields = dict(description)
    model: type[Any] = plugin("fem", fields.pop("name"))
    if "edge_mm" not in fields or "edge_mm" not in field_names("fem", description["name"]):
        raise InputError(
            f"chart.reference.name={description['name']} needs an edge_mm that can be halved: choose solid and give it."
        )
    edge = fields["edge_mm"]
    coarser, coarse, fine = (model(**{**fields, "edge_mm": length}) for length in (2 * edge, edge, edge / 2))
    (first, first_path, _), (second, second_path, _) = (
        simulate(finger, fem, observation, folder) for fem in (coarse, fine)
    )
    if first.provenance["mesh"] == second.provenance["mesh"]:
        raise InputError(
            f"finger={describe(finger)['name']} has the same mesh for edges of {edge:g} and {edge / 2:g} mm, so there "
            "is no converged reference: choose a finger that is meshed here, or a lower chart.reference.edge_mm."
        )
    try:
        before: Dataset | None = simulate(finger, coarser, observation, folder)[0]
    except LabError:  # too coarse a mesh for this finger
        before = None
    element = first.provenance.get("element")
    order = ELEMENTS[element].order if element else ORDER
    return Reference(before, first, second, (edge, edge / 2), (first_path, second_path), order)
