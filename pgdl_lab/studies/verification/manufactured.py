"""A manufactured solution of the Yeoh solid: orders of convergence near incompressibility."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.elements import BEST, ELEMENTS
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.mechanics.term import DeadLoad
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, settle, wavy

Array = NDArray[np.float64]

AMPLITUDES = (0.12, 0.10, 0.08)  # of three shears in turn, x by y, y by z, z by x [mm]
PRESSURE_MPA = 0.05  # of a smooth dilatation, small as the bulk modulus is large
STEP_MM = 1e-3
SOFTER = (0.49, 0.499)  # solved first: between nodes the exact motion changes volumes, a huge pressure when stiffer


def deformation(points: Array, material: Yeoh) -> tuple[Array, Array]:
    """Where the manufactured motion takes `points` (3, …) [mm], and its gradient F (3, 3, …).

    A small dilatation followed by three shears, each of which keeps all volumes: the pressure stays finite as the
    solid becomes incompressible.
    """
    x = points.copy()
    f = np.zeros((3, *points.shape))
    swelling = PRESSURE_MPA / material.bulk_modulus_mpa
    for i in range(3):
        f[i, i] = 1
    f[0, 0] += swelling * np.cos(np.pi * x[0])
    x[0] += swelling / np.pi * np.sin(np.pi * x[0])
    for i, amplitude in enumerate(AMPLITUDES):
        j = (i + 1) % 3
        f[i] += amplitude * np.pi * np.cos(np.pi * x[j]) * f[j]
        x[i] += amplitude * np.sin(np.pi * x[j])
    return x, f


def stress(points: Array, material: Yeoh) -> Array:
    """First Piola–Kirchhoff stress (3, 3, …) [MPa] of the manufactured motion at `points` (3, …) [mm]."""
    _, f = deformation(points, material)
    matrix = np.moveaxis(f, (0, 1), (-2, -1))
    j, inverse = np.linalg.det(matrix), np.moveaxis(np.linalg.inv(matrix), (-1, -2), (0, 1))  # F⁻ᵀ
    invariant = j ** (-2 / 3) * (f * f).sum(axis=(0, 1))
    slope, _ = material.derivatives(invariant)
    isochoric = 2 * slope * (j ** (-2 / 3) * f - invariant / 3 * inverse)
    stresses: Array = isochoric + material.bulk_modulus_mpa * (j - 1) * j * inverse
    return stresses


def body_force(points: Array, material: Yeoh) -> Array:
    """−Div P (3, …) [N/mm³] at `points` (3, …) [mm], by differences of sixth order."""
    force = np.zeros_like(points)
    for axis in range(3):
        shift = STEP_MM * np.eye(3)[axis].reshape(3, *(points.ndim - 1) * (1,))
        for steps, weight in ((1, 45), (2, -9), (3, 1)):
            ahead, behind = (stress(points + sign * steps * shift, material)[:, axis] for sign in (1, -1))
            force -= weight * (ahead - behind) / (60 * STEP_MM)
    return force


def errors(cells: int, element: str, material: Yeoh) -> tuple[float, float]:
    """Errors of displacement [–] in the L² norm and the H¹ seminorm, relative to those of the displacement."""
    equilibrium = body(wavy(cells, element), element, material, {"all": "xyz"})
    mesh = equilibrium.solid.discretisation
    basis = mesh.basis
    points = np.asarray(basis.global_coordinates())
    force = body_force(points, material) * basis.dx
    shapes = np.stack([np.broadcast_to(phi, basis.dx.shape) for (phi,) in basis.basis], axis=1)  # (E, A, Q)
    loads = np.einsum("ieq,eaq->eai", force, shapes)
    forces = np.zeros_like(mesh.positions)
    np.add.at(forces, mesh.nodes, loads)
    at_nodes = deformation(mesh.positions.T, material)[0].T - mesh.positions
    displacement = at_nodes
    for poisson in [softer for softer in SOFTER if softer < material.poisson] + [material.poisson]:
        loaded = equilibrium.with_terms(solid=Solid(mesh, replace(material, poisson=poisson)), push=DeadLoad(forces))
        displacement = settle(loaded, displacement, {"push": 1.0})
    found = [basis.interpolate(displacement[:, i]) for i in range(3)]
    place, gradient = deformation(points, material)
    exact, exact_gradient = place - points, gradient - np.eye(3)[:, :, None, None]
    off = np.stack([np.asarray(field) for field in found]) - exact
    off_gradient = np.stack([field.grad for field in found]) - exact_gradient

    def norm(field: Array) -> float:
        return float(np.sqrt((field**2 * basis.dx).sum()))

    return norm(off) / norm(exact), norm(off_gradient) / norm(exact_gradient)


@benchmark("manufactured Yeoh solution", quick=True)
def manufactured(quick: bool) -> Iterator[Check]:
    """Halve the elements and look by how much the errors fall, for the elements meant for rubber."""
    coarse = 3 if quick else 4
    meant = BEST.values() if quick else [name for name, kind in ELEMENTS.items() if kind.pressure_modes]
    for element in meant:
        order = ELEMENTS[element].order
        for poisson in (0.49, 0.4999):
            material = Yeoh(poisson=poisson)
            before, after = errors(coarse, element, material), errors(2 * coarse, element, material)
            for name, expected, first, last in zip(("L²", "H¹"), (order, order - 1), before, after, strict=True):
                yield Check(
                    f"{element}, ν = {poisson:g}, {coarse}³ to {2 * coarse}³ cells: order of u in {name} [–]",
                    float(expected), float(np.log2(first / last)), 0.3, "theory of quadratic elements",
                )  # fmt: skip
