"""A thick cylinder blown up by a follower pressure, in plane strain."""

from collections.abc import Iterator

import numpy as np
from skfem import MeshHex

from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.term import Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, curved, nodes_on, raise_load

INNER_MM, OUTER_MM = 3.0, 6.0
STRETCHES = (1.1, 1.25, 1.5)


def pressure_mpa(stretch: float, material: Yeoh) -> float:
    """Pressure that stretches the bore of an incompressible cylinder by `stretch` [MPa].

    Radial equilibrium: p = ∫ (σ_θ − σ_r) dr / r with σ_θ − σ_r = 2 (λ² − λ⁻²) dW/dI₁, by Gauss quadrature over the
    undeformed wall, where r² = R² + a² − A².
    """
    place, weight = np.polynomial.legendre.leggauss(30)
    undeformed = (OUTER_MM + INNER_MM) / 2 + (OUTER_MM - INNER_MM) / 2 * place
    r = np.sqrt(undeformed**2 + (stretch**2 - 1) * INNER_MM**2)
    hoop = (r / undeformed) ** 2
    slope, _ = material.derivatives(hoop + 1 / hoop + 1)
    integrand = 2 * (hoop - 1 / hoop) * slope * undeformed / r**2  # dr = R dR / r
    return float((OUTER_MM - INNER_MM) / 2 * (weight * integrand).sum())


@benchmark("thick cylinder, follower pressure", quick=True)
def cylinder(quick: bool) -> Iterator[Check]:
    """A quarter of the cylinder under pressure from inside; the stretch of its bore."""
    radial, around = (3, 4) if quick else (6, 8)
    block = MeshHex.init_tensor(
        np.geomspace(INNER_MM, OUTER_MM, radial + 1), np.linspace(0, np.pi / 2, around + 1), np.array([0.0, 1.0])
    )
    named = {
        "cavity": lambda x: np.isclose(x[0], INNER_MM),
        "x-axis": lambda x: np.isclose(x[1], 0),
        "y-axis": lambda x: np.isclose(x[1], np.pi / 2),
    }
    mesh = curved(block, named, lambda x: np.array([x[0] * np.cos(x[1]), x[0] * np.sin(x[1]), x[2]]))
    for material, name in ((Yeoh(poisson=0.4999), "Yeoh"), (Yeoh(c2_mpa=0.0, poisson=0.4999), "neo-Hooke")):
        equilibrium = body(mesh, "hex27_p1", material, {"x-axis": "y", "y-axis": "x", "body": "z"})
        bore = nodes_on(equilibrium, "cavity")
        positions = equilibrium.solid.discretisation.positions
        branch = raise_load(equilibrium, Ramp({"air": 1.0}), pressure_mpa(STRETCHES[-1], material), 5e-3)
        for stretch in STRETCHES:
            moved = positions + branch.at(pressure_mpa(stretch, material))
            radius = np.hypot(moved[bore, 0], moved[bore, 1])
            yield Check(
                f"{name}, {1e3 * pressure_mpa(stretch, material):.3f} kPa: stretch of the bore [–]",
                stretch, float(radius.mean() / INNER_MM), 1e-3 * stretch,
                "closed form, incompressible (radial equilibrium)",
            )  # fmt: skip
            if stretch == STRETCHES[-1]:
                yield Check(
                    f"{name}: out of round of the bore [–]", 0.0, float(np.ptp(radius) / INNER_MM), 1e-3, "symmetry"
                )
