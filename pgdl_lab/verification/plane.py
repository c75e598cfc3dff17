"""The plane elements and the air between them: a small-strain cantilever and a thick cylinder, both in plane strain."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from skfem import MeshQuad, MeshQuad2

from pgdl_lab.mechanics.air import Air
from pgdl_lab.mechanics.contact import NoContact
from pgdl_lab.mechanics.equilibrium import Equilibrium, Load
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.section import discretise_plane, part
from pgdl_lab.mechanics.solid import Solid
from pgdl_lab.verification.benchmark import Check, benchmark
from pgdl_lab.verification.bodies import raise_load, settle
from pgdl_lab.verification.cylinder import INNER_MM, OUTER_MM, STRETCHES, pressure_mpa

WIDTH_MM = 2.0
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
    no_air = Air(part(body, np.arange(1), np.ones(1)))
    equilibrium = Equilibrium(Solid(body, law), no_air, np.array([0.0, 0.0, -load]), free, NoContact())
    displacement = settle(equilibrium, np.zeros_like(body.positions))
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
    equilibrium = Equilibrium(Solid(solid, law), Air(air), np.zeros(3), free, NoContact())
    branch = raise_load(equilibrium, lambda p: Load(0.0, p), pressure_mpa(STRETCHES[-1], law), 5e-3)
    for stretch in STRETCHES:
        pressure = pressure_mpa(stretch, law)
        moved = body.positions + branch.at(pressure)
        obtained = float(np.hypot(moved[bore, 0], moved[bore, 2]).mean() / INNER_MM)
        yield Check(
            f"{1e3 * pressure:.3f} kPa: stretch of the bore [–]", stretch, obtained, 1e-3 * stretch,
            "closed form, incompressible (radial equilibrium)",
        )  # fmt: skip
