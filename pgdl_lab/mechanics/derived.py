"""What the mechanics make of a displacement of the whole body: stretches, stress, volumes of chambers, reaction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from omegaconf import OmegaConf

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, restored
from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.invariants import COLUMNS, PLACES, ROWS
from pgdl_lab.mechanics.solid import InvertedElement

Array = NDArray[np.float64]

SAME_MM = 1e-6  # nodes of a mesh that is made again lie as near to those that are known


class Known(Protocol):
    """What says which body its displacements are of: a dataset of it or a surrogate."""

    @property
    def domain(self) -> Domain: ...
    @property
    def provenance(self) -> Mapping[str, Any]: ...


class Mechanics:
    """The finite elements of a finger, asked about a displacement u (N, 3) [mm] of all nodes of its whole body.

    Values inside the body are those at the Q quadrature points of its E elements; `mean` averages them over each
    element. What is said of the finger is said of the whole one, also where only its half y ≥ 0 is meshed.

    Parameters
    ----------
    model
        The mesh, its elements, material and loads.

    Examples
    --------
    >>> import pgdl_lab as lab
    >>> finger, coarse = lab.Pneunet(chambers=1, max_kpa=4.0), lab.Solid(edge_mm=8.0, estimate_error=False)
    >>> body = lab.simulate(finger, coarse, observation=lab.Observation(snapshots=2, points=400)).body
    >>> mechanics = lab.Mechanics.of(body)
    >>> bool(mechanics.chamber_volumes_mm3(body.displacements[-1]) > mechanics.chamber_volumes_mm3())
    True
    """

    def __init__(self, model: Model) -> None:
        self.model = model

    @classmethod
    def of(cls, known: Known) -> Mechanics:
        """Those of the finger that a dataset of the whole body or a surrogate is of, meshed again.

        Raises
        ------
        InputError
            When `known` does not say how its body was simulated, or this version meshes it otherwise.
        """
        told = known.provenance
        if not known.domain.is_body or not {"finger", "fem"} <= told.keys() or "edge_mm" not in told["fem"]:
            raise InputError(
                "Only a whole body that fem=solid simulated has its mechanics: take the body of a dataset of "
                "pgdl_lab.simulate, or a surrogate that was trained on it."
            )
        discover("finger", "material")
        finger: Any = OmegaConf.to_object(restored("finger", told["finger"]))
        model = Model(finger, told["fem"]["edge_mm"], told.get("element", "hex20"))
        nodes = model.discretisation.positions
        if nodes.shape != known.domain.points_mm.shape or np.abs(nodes - known.domain.points_mm).max() > SAME_MM:
            raise InputError("This version of pgdl_lab meshes the finger otherwise: simulate it again.")
        return cls(model)

    def stretches(self, displacement_mm: ArrayLike) -> Array:
        """Principal stretches (E, Q, 3) [–], the largest first: the singular values of F = 1 + ∂u/∂X."""
        found: Any = np.linalg.svd(self._gradients(displacement_mm), compute_uv=False)
        return found

    def stress_mpa(self, displacement_mm: ArrayLike) -> Array:
        """Cauchy stress (E, Q, 3, 3) [MPa], σ = F S Fᵀ / J + p 1.

        S is the isochoric second Piola–Kirchhoff stress of the law and p the pressure that the elements carry, the bulk
        modulus times their dilatation.
        """
        moved, f = self._checked(displacement_mm), self._gradients(displacement_mm)
        right = np.moveaxis(f.swapaxes(2, 3) @ f, (2, 3), (0, 1))[ROWS, COLUMNS]  # (6, E, Q)
        isochoric = np.moveaxis(
            self.model.finger.material.isochoric(right, tangent=False).stress[PLACES], (0, 1), (2, 3)
        )
        with _whole():
            pressure = self.model.equilibrium.solid.pressure(moved)
        deviatoric = f @ isochoric @ f.swapaxes(2, 3) / np.linalg.det(f)[..., None, None]
        result: Array = deviatoric + pressure[..., None, None] * np.eye(3)
        return result

    def von_mises_mpa(self, displacement_mm: ArrayLike) -> Array:
        """Von Mises' equivalent (E, Q) of the Cauchy stress [MPa]: the root of 3/2 s : s, s its deviator."""
        stress = self.stress_mpa(displacement_mm)
        deviator = stress - np.trace(stress, axis1=2, axis2=3)[..., None, None] / 3 * np.eye(3)
        return np.sqrt(1.5 * (deviator**2).sum(axis=(2, 3)))

    def chamber_volumes_mm3(self, displacement_mm: ArrayLike | None = None) -> Array:
        """Volume that each chamber encloses (H,) [mm³], from the root to the tip; None stands for the body at rest."""
        rest = np.zeros_like(self.model.discretisation.positions)
        moved = rest if displacement_mm is None else self._checked(displacement_mm)
        return self._copies * np.array([chamber.volume_mm3(moved) for chamber in self._chambers])

    def reaction_n(self, displacement_mm: ArrayLike, pressure_kpa: float) -> tuple[Array, Array]:
        """Force of the support on the finger, and sum of its weight and of the air on its walls: (3,) each [N].

        They cancel where the finger is in equilibrium. The first comes from the stress at the clamp, which a small
        error of the displacement changes much; the second does not.
        """
        moved = self._checked(displacement_mm)
        with _whole():
            reaction, load = self.model.reaction_and_load_n(moved, pressure_kpa)
        if self._copies == 2:  # forces along y of both halves cancel
            reaction, load = (each * [2.0, 0.0, 2.0] for each in (reaction, load))
        return reaction, load

    def mean(self, values: Array) -> Array:
        """Mean (E, …) over each undeformed element of values (E, Q, …) at its quadrature points."""
        weights = self.model.discretisation.weights
        result: Array = np.einsum("eq,eq...->e...", weights / weights.sum(axis=1, keepdims=True), values)
        return result

    @property
    def _copies(self) -> int:
        """How many of what is meshed make the finger."""
        return 2 if "symmetry" in self.model.mesh.boundaries else 1

    @cached_property
    def _chambers(self) -> list[Cavity]:
        """The walls of each chamber: facets that share nodes are of one."""
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import connected_components

        mesh, basis = self.model.mesh, self.model.discretisation.basis
        walls = np.asarray(mesh.boundaries["cavity"])
        corners = mesh.facets[:, walls]
        row = np.tile(np.arange(len(walls)), len(corners))
        touched = csr_matrix((np.ones(row.size), (row, corners.ravel())), shape=(len(walls), mesh.p.shape[1]))
        count, number = connected_components(touched @ touched.T, directed=False)
        middle_x = mesh.p[0][corners].mean(axis=0)
        order = np.argsort([middle_x[number == each].mean() for each in range(count)])
        return [Cavity(basis, walls[number == each]) for each in order]

    def _gradients(self, displacement_mm: ArrayLike) -> Array:
        """Deformation gradients F (E, Q, 3, 3)."""
        mesh = self.model.discretisation
        nodal = self._checked(displacement_mm)[mesh.nodes]
        result: Array = np.einsum("eai,eajq->eqij", nodal, mesh.gradients) + np.eye(3)
        return result

    def _checked(self, displacement_mm: ArrayLike) -> Array:
        moved, shape = np.asarray(displacement_mm, dtype=np.float64), self.model.discretisation.positions.shape
        if moved.shape != shape or not np.isfinite(moved).all():
            raise InputError(
                f"The displacement has shape {moved.shape}; it must be {shape}, finite numbers in mm for all nodes of "
                "the whole body."
            )
        return moved


@contextmanager
def _whole() -> Iterator[None]:
    """Tell of a displacement that has no stress."""
    try:
        yield
    except InvertedElement:
        raise InputError(
            "This displacement turns an element inside out, so that it has no stress: take one of the simulation, or "
            "train on more points."
        ) from None
