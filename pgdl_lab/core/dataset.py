"""The dataset: fields on a domain in some cases, such as the displacement of the side face at rising pressures."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset_file import DISPLACEMENT, DamagedDataset, Tree, read, unreadable, write
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.heard import WARNINGS
from pgdl_lab.core.inputs import Cases, Input, unit_of
from pgdl_lab.core.plotting import picture, plot_side

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Dataset:
    """Fields on a domain of N points in C cases of D inputs.

    A case is one point in the space of the inputs. A simulation that follows a load gives many of them: a path of
    rising pressure is a dataset of one input, made by `Dataset.path`. Simulations that differ in something else are
    put together by `Dataset.joined`, and that is another input.

    Attributes
    ----------
    domain
        What the fields live on.
    cases
        The inputs, their values in the C cases, and which simulation each comes from.
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
    cases: Cases
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
        return cls(domain, Cases.path(pressures_kpa), {DISPLACEMENT: displacements}, **beside)

    @classmethod
    def joined(cls, simulations: Sequence[Dataset], **values: Sequence[float]) -> Dataset:
        """Simulations on one domain that differ in further inputs.

        Parameters
        ----------
        simulations
            Datasets of the same inputs whose undeformed points and elements are the same.
        values
            By the name of each further input, which ends with its unit, its value in each simulation.

        Raises
        ------
        InputError
            When the domains or the inputs differ, or the values do not fit.

        Examples
        --------
        >>> import pgdl_lab as lab
        >>> turned = [lab.Pneunet(chambers=2, max_kpa=10.0, gravity_m_s2=[x, 0.0, -9.81]) for x in (-5.0, 0.0, 5.0)]
        >>> runs = [lab.simulate(finger, lab.Rod(), observation=lab.Observation(10, 200)) for finger in turned]
        >>> lab.Dataset.joined(runs, gravity_x_m_s2=[-5.0, 0.0, 5.0]).cases.names
        ['pressure_kpa', 'gravity_x_m_s2']
        """
        _require_joinable(simulations, values)
        first, columns = simulations[0], np.array(list(values.values()), dtype=np.float64).T
        inputs = tuple(
            Input(each.name, each.unit, *ends([one.cases.values[:, number] for one in simulations]))
            for number, each in enumerate(first.cases.inputs)
        ) + tuple(Input(name, unit_of(name), *ends([given])) for name, given in values.items())
        cases, counts = [], np.cumsum([0, *(1 + one.cases.simulation.max() for one in simulations)])
        for one, column, before in zip(simulations, columns, counts[:-1], strict=True):
            more = np.repeat(column[None], len(one.cases), axis=0)
            cases.append(Cases(inputs, np.concatenate([one.cases.values, more], axis=1), one.cases.simulation + before))
        names = [name for name in first.fields if all(name in one.fields for one in simulations)]
        bodies = [one.body for one in simulations if one.body is not None]
        whole = len(bodies) == len(simulations) and all(_alike(bodies[0].domain, body.domain) for body in bodies)
        return cls(
            first.domain,
            reduce(Cases.joined, cases),
            {name: np.concatenate([one.fields[name] for one in simulations]) for name in names},
            cls.joined(bodies, **values) if whole else None,
            _common_provenance(simulations),
        )

    @property
    def displacements(self) -> NDArray[np.float64]:
        """Displacements (C, N, k) [mm]."""
        return self.fields[DISPLACEMENT]

    @property
    def pressures_kpa(self) -> NDArray[np.float64]:
        """The pressure (C,) in each case [kPa]."""
        return self.cases.pressures_kpa

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
            "inputs": [asdict(each) for each in self.cases.inputs],
            "points_mm": domain.points_mm,
            "cells": domain.cells,
            "base": domain.base,
            "clamp": domain.clamp,
            "cases": self.cases.values,
            "simulation": self.cases.simulation,
            "fields": dict(self.fields),
            **({} if self.body is None else {"body": {**self.body._tree(), "provenance": {}}}),
        }

    @classmethod
    def _of(cls, tree: Tree) -> Dataset:
        domain = Domain(*(tree[name] for name in ("points_mm", "cells", "cell_type", "base", "clamp")))
        inputs = tuple(Input(**each) for each in tree["inputs"])
        body = cls._of(tree["body"]) if "body" in tree else None
        cases = Cases(inputs, tree["cases"], tree["simulation"])
        return cls(domain, cases, tree["fields"], body, tree["provenance"])

    def fits(self) -> bool:
        """Whether the arrays fit together."""
        cases, nodes = len(self.cases), len(self.domain.points_mm)
        return (
            self.domain.fits()
            and self.cases.fits()
            and DISPLACEMENT in self.fields
            and all(each.dtype == np.float64 for each in self.fields.values())
            and all(each.ndim == 3 and each.shape[:2] == (cases, nodes) for each in self.fields.values())
            and self.displacements.shape[2] == self.domain.points_mm.shape[1]
            and all(np.isfinite(each).all() for each in self.fields.values())
            and (self.body is None or self.body.fits())
            and isinstance(self.provenance, dict)
        )


def ends(parts: Sequence[NDArray[np.float64] | Sequence[float]]) -> tuple[float, float]:
    """Least and greatest of some values."""
    values = np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])
    return float(values.min()), float(values.max())


def _alike(one: Domain, other: Domain) -> bool:
    return one.cell_type == other.cell_type and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("points_mm", "cells", "base", "clamp")
    )


def _require_joinable(simulations: Sequence[Dataset], values: Mapping[str, Sequence[float]]) -> None:
    if not simulations or not values:
        raise InputError(
            "Dataset.joined takes at least one simulation, and a value of a further input for each of them."
        )
    first = simulations[0]
    for number, one in enumerate(simulations):
        if not _alike(first.domain, one.domain):
            raise InputError(
                f"Simulation {number} lives on another mesh than the first: join simulations whose undeformed fingers "
                "and meshes are the same."
            )
        if one.cases.names != first.cases.names:
            raise InputError(f"Simulation {number} has inputs {one.cases.names}, but the first {first.cases.names}.")
    for name, given in values.items():
        if name in first.cases.names:
            raise InputError(f"'{name}' is an input of the simulations already; give the further one another name.")
        if len(given) != len(simulations) or not np.isfinite(np.asarray(given, dtype=np.float64)).all():
            raise InputError(
                f"{name} is {list(given)}; give one finite number for each of the {len(simulations)} simulations."
            )
        if len(set(given)) == 1:
            raise InputError(f"{name} is {given[0]:g} in all simulations, so that it is no input; leave it out.")


def _common_provenance(simulations: Sequence[Dataset]) -> dict[str, Any]:
    """What is the same for all, each warning once, and the provenance of each as "simulations"."""
    first = simulations[0].provenance
    common = {
        key: value for key, value in first.items() if all(one.provenance.get(key) == value for one in simulations)
    }
    warned = list(dict.fromkeys(sentence for one in simulations for sentence in one.warnings))
    return {**common, WARNINGS: warned, "simulations": [one.provenance for one in simulations]}
