"""Plane elements and air between them: cantilever and thick cylinder in plane strain, tension in plane stress."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from skfem import MeshQuad, MeshQuad2

from pgdl_lab.mechanics.air import Air
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.material import Array, Yeoh
from pgdl_lab.mechanics.plane_stress import PlaneStress
from pgdl_lab.mechanics.section import discretise_plane, part
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.mechanics.term import DeadLoad, Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import raise_load, settle
from pgdl_lab.studies.verification.cylinder import INNER_MM, OUTER_MM, STRETCHES, pressure_mpa
from pgdl_lab.studies.verification.homogeneous import laws
from pgdl_lab.studies.verification.tangents import off

WIDTH_MM = 2.0
PULLED = (1.1, 1.5, 2.0)
LAYER = 1e-8  # of the stiffness of the wall; even by its bulk modulus it must not bear the pressure


@benchmark("plane elements, cantilever at small strain", quick=True)
def cantilever(quick: bool) -> Iterator[Check]:
    """Sag under a small weight along −z; Timoshenko's beam with E / (1 − ν²)."""
    length, depth, law, load = 40.0, 2.0, Yeoh(c2_mpa=0.0, poisson=0.3), 1e-7
    mesh = MeshQuad.init_tensor(np.linspace(0, length, 41), np.linspace(0, depth, 3))
    body = discretise_plane(mesh, np.full(mesh.nelements, WIDTH_MM))
    free = np.ones(body.positions.shape, dtype=bool)
    free[:, 1] = False
    free[np.isclose(body.positions[:, 0], 0)] = False
    weight = DeadLoad.weight(body, np.array([0.0, 0.0, -load]))
    equilibrium = Equilibrium({"solid": Solid(body, law), "weight": weight}, free)
    displacement = settle(equilibrium, np.zeros_like(body.positions), {"weight": 1.0})
    tip = np.isclose(body.positions[:, 0], length) & np.isclose(body.positions[:, 2], depth / 2)
    young = 2 * law.shear_modulus_mpa * (1 + law.poisson) / (1 - law.poisson**2)
    bending = load * depth * length**4 / (8 * young * depth**3 / 12)
    shear = load * length**2 / (2 * 5 / 6 * law.shear_modulus_mpa)
    yield Check(
        "sag over that of the beam [–]",
        1.0,
        float(-displacement[tip, 2].mean() / (bending + shear)),
        0.01,
        "Timoshenko",
    )


@benchmark("plane elements, thick cylinder", quick=True)
def cylinder(quick: bool) -> Iterator[Check]:
    """A quarter of the cylinder; elements of air fill its bore, beside a layer too soft to matter."""
    radial, around = (3, 4) if quick else (6, 8)
    radii = np.concatenate([[0.0, INNER_MM / 2], np.geomspace(INNER_MM, OUTER_MM, radial + 1)])
    straight = MeshQuad2.from_mesh(MeshQuad.init_tensor(radii, np.linspace(0, np.pi / 2, around + 1)))
    r, angle = straight.doflocs
    mesh = replace(straight, doflocs=np.array([r * np.cos(angle), r * np.sin(angle)]))
    body = discretise_plane(mesh, np.full(mesh.nelements, WIDTH_MM))
    bored = np.hypot(*body.positions[body.nodes][:, :, [0, 2]].mean(axis=1).T) < INNER_MM
    x, _, z = body.positions.T
    radius = np.hypot(x, z)
    free = np.ones(body.positions.shape, dtype=bool)
    free[:, 1] = False
    free[np.isclose(x, 0), 0] = free[np.isclose(z, 0), 2] = False
    free[np.isclose(radius, 0)] = False  # every element has nodes of its own there
    bore = np.isclose(radius, INNER_MM)
    solid = part(body, np.arange(len(bored)), np.where(bored, LAYER, 1.0))
    air = part(body, np.flatnonzero(bored), np.ones(bored.sum()))
    law = Yeoh(poisson=0.4999)
    equilibrium = Equilibrium({"solid": Solid(solid, law), "air": Air(air)}, free)
    branch = raise_load(equilibrium, Ramp({"air": 1.0}), pressure_mpa(STRETCHES[-1], law), 5e-3)
    for stretch in STRETCHES:
        pressure = pressure_mpa(stretch, law)
        moved = body.positions + branch.at(pressure)
        obtained = float(np.hypot(moved[bore, 0], moved[bore, 2]).mean() / INNER_MM)
        yield Check(
            f"{1e3 * pressure:.3f} kPa: stretch of the bore [–]", stretch, obtained, 1e-3 * stretch,
            "closed form, incompressible (radial equilibrium)",
        )  # fmt: skip


@benchmark("plane stress, uniaxial tension", quick=True)
def uniaxial(quick: bool) -> Iterator[Check]:
    """Pull a block that is free to thin in the plane and across it; its tangent beside differences."""
    mesh = MeshQuad.init_tensor(np.linspace(0, 2, 3), np.linspace(0, 1, 3))
    body = discretise_plane(mesh, np.full(mesh.nelements, WIDTH_MM))
    x, _, z = body.positions.T
    free = np.ones(body.positions.shape, dtype=bool)
    free[:, 1] = False
    free[np.isclose(x, 0) | np.isclose(x, 2), 0] = False
    free[np.isclose(z, 0), 2] = False
    random = np.random.default_rng(0)
    for name, law, closed_form in laws():
        solid = Solid(body, PlaneStress(law))

        def forces_of(displacement: Array, solid: Solid = solid) -> Array:
            return solid.response(displacement, stiffness=False).forces

        equilibrium = Equilibrium({"solid": solid}, free)
        for stretch in PULLED:
            start = body.positions * [stretch - 1, 0.0, stretch**-0.5 - 1]
            inside = free * 0.01 * random.normal(size=start.shape)
            found = settle(equilibrium, start + inside)
            forces = equilibrium.balance(found, {}, stiffness=False).forces
            nominal = closed_form(stretch, 0.5)
            yield Check(
                f"{name}, stretch {stretch:g}: nominal stress [MPa]", nominal,
                float(forces[np.isclose(x, 2), 0].sum() / WIDTH_MM), 1e-4 * nominal, "closed form, incompressible",
            )  # fmt: skip
        direction = random.normal(size=free.shape) * [1, 0, 1]
        local = direction[body.nodes].reshape(len(body.nodes), -1)
        stiffness = solid.response(start + inside, stiffness=True).stiffness
        assert stiffness is not None
        error = off((stiffness @ local[..., None])[..., 0], forces_of, start + inside, direction)
        yield Check(f"{name}: stiffness [–]", 0.0, error, 1e-6, "central differences")
