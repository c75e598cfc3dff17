"""Every tangent beside central differences of what it is the derivative of."""

from collections.abc import Callable, Iterator

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from pgdl_lab.core.registry import names, plugin
from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.elements import ELEMENTS
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.material import Material, Yeoh
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, wavy

Array = NDArray[np.float64]

STEP_MM = 1e-6
SOURCE = "central differences"
GAP_MM = 1.0  # between the two chambers of the finger
REACH_MM = 0.1


def off(derivative: Array, function: Callable[[Array], Array], at: Array, direction: Array) -> float:
    """Largest error of a directional `derivative` relative to its largest entry."""
    change = (function(at + STEP_MM * direction) - function(at - STEP_MM * direction)) / (2 * STEP_MM)
    return float(np.abs(derivative - change).max() / np.abs(change).max())


def solid_off(element: str, material: Material, random: np.random.Generator, strained: Array, noise_mm: float) -> float:
    """Error, as `off`, of the stiffness of a cube with deformation gradient `strained` and displaced at random."""
    solid = body(wavy(2, element), element, material, {}).solid
    mesh = solid.discretisation
    at = mesh.positions @ (strained - np.eye(3)).T + noise_mm * random.normal(size=mesh.positions.shape)
    direction = random.normal(size=mesh.positions.shape)
    local = direction[mesh.nodes].reshape(len(mesh.nodes), -1)
    stiffness = solid.response(at, stiffness=True).stiffness
    assert stiffness is not None
    return off(
        (stiffness @ local[..., None])[..., 0], lambda u: solid.response(u, stiffness=False).forces, at, direction
    )


@benchmark("tangents against differences", quick=True)
def tangents(quick: bool) -> Iterator[Check]:
    """Solid, follower pressure, contact and all of them together, on a finger of two chambers that touch."""
    random = np.random.default_rng(0)
    for element in ELEMENTS:
        yield Check(
            f"stiffness of the solid, {element}, third-order Yeoh [–]",
            0.0, solid_off(element, Yeoh(c3_mpa=0.003), random, np.eye(3), 0.01), 1e-6, SOURCE,
        )  # fmt: skip
    for law in names("material"):
        # Stretches that are the same, or almost, besides those that differ.
        for state, stretched, noise in (("undeformed", 1.0, 0.0), ("uniaxial", 1.5, 1e-9), ("uneven", 1.5, 0.01)):
            strained = np.diag([stretched, stretched**-0.5, stretched**-0.5])
            error = solid_off("hex27_p1", plugin("material", law)(), np.random.default_rng(0), strained, noise)
            yield Check(f"stiffness of the solid, {law}, {state} [–]", 0.0, error, 1e-6, SOURCE)

    finger = plugin("finger", "pneunet")(chambers=2, gap_mm=GAP_MM)
    model = Model(finger, 6.0, "hex27_p1")
    mesh, free, cavity = model.discretisation, model.equilibrium.free, Cavity(model.discretisation.basis)
    at, direction = 0.02 * random.normal(size=free.shape), random.normal(size=free.shape)
    local = direction[cavity.nodes].reshape(len(cavity.nodes), -1)
    hessian = cavity.response(at, stiffness=True).stiffness
    error = off(
        (hessian @ local[..., None])[..., 0], lambda u: cavity.response(u, stiffness=False).forces, at, direction
    )
    yield Check("load stiffness of the pressure [–]", 0.0, error, 1e-6, SOURCE)

    contact = Contact(mesh, REACH_MM, finger.material.shear_modulus_mpa, "on")
    x, _, z = mesh.positions.T
    middle = finger.root_mm + finger.chamber_length_mm + GAP_MM / 2
    bottom = finger.base_mm + finger.channel_mm + finger.bridge_mm  # of the gap
    tilt = np.where(x > middle, np.maximum(z - bottom, 0) / (z.max() - bottom), 0.0)
    closed = tilt[:, None] * [0.6 * REACH_MM - GAP_MM, 0.0, 0.21] + 0.05 * at
    touch = contact.response(closed, stiffness=True)
    error = off(
        touch.stiffness @ direction.ravel(),
        lambda u: contact.response(u, stiffness=False).forces.ravel(),
        closed,
        direction,
    )
    yield Check("stiffness of contact [–]", 0.0, error, 1e-5, SOURCE)

    equilibrium, load = model.equilibrium.with_terms(contact=contact), {"weight": 1.0, "air": 0.03}
    at, direction = closed * free, direction * free
    upper = equilibrium.balance(at, load, stiffness=True).stiffness
    assert upper is not None
    error = off(
        (upper + sp.triu(upper, 1).T) @ direction[free],
        lambda u: equilibrium.balance(u, load, stiffness=False).forces[free],
        at,
        direction,
    )
    yield Check("whole stiffness as it is factorised [–]", 0.0, error, 1e-5, SOURCE)
