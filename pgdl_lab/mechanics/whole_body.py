"""The whole body of a simulation at any pressure of its load path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import TANGENT
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import BODY, Observation
from pgdl_lab.mechanics.path import Branch


def observed(data: Dataset, observation: Observation) -> Dataset:
    """What is observed of a simulation: its side face, as it is, or its whole body at the same pressures.

    Raises
    ------
    InputError
        When the body is asked for and there is none.
    """
    if observation.of != BODY:
        return data
    if data.body is None:
        fem = data.provenance.get("fem", {}).get("name", "this model")
        raise InputError(f"fem={fem} knows no whole body: leave out observation.of={BODY}, or choose fem=solid.")
    return learnable(followed(data.body, data.pressures_kpa))


def learnable(body: Dataset) -> Dataset:
    """A body whose nodes are all corners of simplices: of elements with 20 nodes the corners alone."""
    domain = body.domain
    if domain.cell_type != "hexahedron20":
        return body
    nodes, cells = np.unique(domain.cells[:, :8], return_inverse=True)
    number = np.full(len(domain.points_mm), -1)
    number[nodes] = np.arange(len(nodes))
    base, clamp = (number[each][number[each] >= 0] for each in (domain.base, domain.clamp))
    corners = Domain(domain.points_mm[nodes], cells.reshape(-1, 8), "hexahedron", base, clamp)
    return replace(body, domain=corners, fields={name: field[:, nodes] for name, field in body.fields.items()})


def followed(body: Dataset, pressures_kpa: NDArray[np.float64]) -> Dataset:
    """A body at pressures (P,) [kPa], from its equilibria and their tangents, as the load path itself interpolates.

    Raises
    ------
    InputError
        When there is a pressure without an equilibrium and there are no tangents, or several simulations are joined.
    """
    if body.cases.simulation.any():
        raise InputError("This body is that of several simulations: follow each alone, and join them afterwards.")
    known = body.pressures_kpa
    nearest = np.abs(known[:, None] - pressures_kpa).argmin(axis=0)
    if np.allclose(known[nearest], pressures_kpa, rtol=1e-12):
        moved = body.displacements[nearest]
    elif TANGENT in body.fields:
        path = Branch(known.tolist(), list(body.displacements), list(body.fields[TANGENT]))
        moved = np.array([path.at(float(kpa)) for kpa in pressures_kpa])
    else:
        raise InputError(
            f"This body is known at {len(known)} pressures alone, without tangents: simulate it again with fem=solid."
        )
    return replace(Dataset.path(body.domain, pressures_kpa, moved), provenance=body.provenance)
