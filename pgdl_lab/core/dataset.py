"""The dataset: fields on a domain in some cases, such as the displacement of the side face at rising pressures."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset_file import DISPLACEMENT, DamagedDataset, Tree, read, unreadable, write
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.heard import WARNINGS
from pgdl_lab.core.inputs import PRESSURE, Input, column, pressure
from pgdl_lab.core.plotting import picture, plot_side

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Dataset:
    """Fields on a domain of N points in C cases of D inputs.

    A case is one point in the space of the inputs. A simulation that follows a load gives many of them: a path of
    rising pressure is a dataset of one input, made by `Dataset.path`.

    Attributes
    ----------
    domain
        What the fields live on.
    inputs
        The D inputs.
    cases
        (C, D) float64, their values in each case.
    simulation
        (C,) int64, which simulation each case comes from.
    fields
        (C, N, k) float64 by name; "displacement_mm" is always there, and of a body that was followed along its load
        "tangent_mm_per_kpa".
    body
        The whole body at the equilibria that were solved for, with the same provenance; None where the model has no
        body.
    provenance
        Finger, mesh, material, solver, versions: everything needed to say where the numbers come from (JSON types
        only); "warnings" are sentences on what may be wrong with them.
    """

    domain: Domain
    inputs: tuple[Input, ...]
    cases: NDArray[np.float64]
    simulation: NDArray[np.int64]
    fields: Mapping[str, NDArray[np.float64]]
    body: Dataset | None = None
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.body is not None:  # one dictionary, so that what is added later is known of both
            object.__setattr__(self, "body", replace(self.body, provenance=self.provenance))

    @classmethod
    def path(
        cls, domain: Domain, pressures_kpa: NDArray[np.float64], displacements: NDArray[np.float64], **beside: Any
    ) -> Dataset:
        """One simulation at rising pressures (C,) [kPa], by its displacements (C, N, d) [mm].

        Parameters
        ----------
        beside
            "body" and "provenance".
        """
        cases = np.asarray(pressures_kpa, dtype=np.float64)[:, None]
        inputs = pressure(float(cases.max(initial=0.0)))
        return cls(domain, inputs, cases, np.zeros(len(cases), dtype=np.int64), {DISPLACEMENT: displacements}, **beside)

    @property
    def displacements(self) -> NDArray[np.float64]:
        """Displacements (C, N, k) [mm]."""
        return self.fields[DISPLACEMENT]

    @cached_property
    def pressures_kpa(self) -> NDArray[np.float64]:
        """The pressure (C,) in each case [kPa]."""
        return column(self.inputs, self.cases, PRESSURE)

    @property
    def warnings(self) -> list[str]:
        """What the simulation warned of, in sentences."""
        return list(self.provenance.get(WARNINGS, ()))

    @property
    def _finger(self) -> str:
        return str(self.provenance.get("finger", {}).get("name", "a finger"))

    def __repr__(self) -> str:
        cases, points = self.displacements.shape[:2]
        fem = self.provenance.get("fem", {}).get("name", "unknown elements")
        of = "its body" if self.domain.is_body else "its side face"
        return (
            f"<Dataset of {self._finger} by {fem}: {points:,} points of {of} at {cases} pressures up to "
            f"{self.pressures_kpa.max(initial=0.0):g} kPa>"
        )

    def _repr_html_(self) -> str:
        """A sentence and a picture, for notebooks."""
        told = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in [repr(self)[1:-1], *self.warnings])
        return told + picture(lambda axes: self.plot(float(self.pressures_kpa[-1]), axes), "the bent finger")

    def plot(self, pressure_kpa: float, axes: Axes | None = None) -> Axes:
        """Draw the bent side face, or the body from the side, over its shape at rest.

        Parameters
        ----------
        pressure_kpa
            The case that is nearest to it is drawn [kPa].
        axes
            Where to draw, by default in a new figure of pyplot.

        Raises
        ------
        InputError
            When the pressure lies outside those of the dataset.
        """
        known = self.pressures_kpa
        if not 0 <= pressure_kpa <= known.max():
            raise InputError(
                f"pressure_kpa is {pressure_kpa:g}; this dataset goes from {known.min():g} to {known.max():g} kPa."
            )
        nearest = int(np.abs(known - pressure_kpa).argmin())
        return plot_side(self.domain, self.displacements[nearest], f"{self._finger} at {known[nearest]:g} kPa", axes)

    def save(self, path: str | Path) -> None:
        """Write an HDF5 file; `path` appears only when the file is whole."""
        write(Path(path), self._tree())

    @classmethod
    def load(cls, path: str | Path) -> Dataset:
        """Read what `save` wrote; nothing in the file is ever run as code.

        Raises
        ------
        DamagedDataset
            When the file is truncated, altered or not one of ours; the message says which.
        LabError
            When it cannot be opened now.
        """
        path = Path(path)
        try:
            dataset = cls._of(read(path))
            fits = dataset.fits()
        except (KeyError, ValueError, TypeError) as error:
            raise unreadable(path, error) from error
        if not fits:
            raise DamagedDataset(f"{path} holds arrays that do not fit together; delete it to compute it again.")
        return dataset

    def _tree(self) -> Tree:
        domain = self.domain
        return {
            "provenance": self.provenance,
            "cell_type": domain.cell_type,
            "inputs": [asdict(each) for each in self.inputs],
            "points_mm": domain.points_mm,
            "cells": domain.cells,
            "base": domain.base,
            "clamp": domain.clamp,
            "cases": self.cases,
            "simulation": self.simulation,
            "fields": dict(self.fields),
            **({} if self.body is None else {"body": {**self.body._tree(), "provenance": {}}}),
        }

    @classmethod
    def _of(cls, tree: Tree) -> Dataset:
        domain = Domain(*(tree[name] for name in ("points_mm", "cells", "cell_type", "base", "clamp")))
        inputs = tuple(Input(**each) for each in tree["inputs"])
        body = cls._of(tree["body"]) if "body" in tree else None
        cases, simulation, fields = (tree[name] for name in ("cases", "simulation", "fields"))
        return cls(domain, inputs, cases, simulation, fields, body, tree["provenance"])

    def fits(self) -> bool:
        """Whether the arrays fit together."""
        cases, nodes = len(self.cases), len(self.domain.points_mm)
        floats = [self.cases, *self.fields.values()]
        return (
            self.domain.fits()
            and all(array.dtype == np.float64 for array in floats)
            and self.simulation.dtype == np.int64
            and self.cases.shape == (cases, len(self.inputs))
            and self.simulation.shape == (cases,)
            and DISPLACEMENT in self.fields
            and all(each.ndim == 3 and each.shape[:2] == (cases, nodes) for each in self.fields.values())
            and self.displacements.shape[2] == self.domain.points_mm.shape[1]
            and all(np.isfinite(array).all() for array in floats)
            and (self.body is None or self.body.fits())
            and isinstance(self.provenance, dict)
        )
