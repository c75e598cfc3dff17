"""Cook's membrane: a tapered panel held on the left and sheared on the right."""

from collections.abc import Iterator

import numpy as np
from skfem import MeshHex

from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.term import Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, pulled, raise_load

SHEAR_MODULUS_MPA, BULK_MODULUS_MPA = 80.1938, 40.0942e4
FORCE_N_MM = 100.0  # per thickness


def panel(cells: int, thickness_mm: float) -> MeshHex:
    """The panel, `cells` by `cells` and one across its thickness, with boundaries `left`, `right` and `face`."""
    grid = np.linspace(0, 1, cells + 1)
    block = MeshHex.init_tensor(grid, grid, np.array([0.0, thickness_mm]))
    s, t, z = block.p
    return MeshHex(np.array([48 * s, 44 * s + t * (44 - 28 * s), z]), block.t).with_boundaries(
        {
            "left": lambda x: np.isclose(x[0], 0),
            "right": lambda x: np.isclose(x[0], 48),
            "face": lambda x: np.isclose(x[2], 0),
        }
    )


@benchmark("Cook's membrane, linear, plane stress", quick=True)
def linear(quick: bool) -> Iterator[Check]:
    """The first tangent of the solid is linear elasticity; a thin panel with free faces is in plane stress.

    Published values of the deflection for E = 1, ν = 1/3 and a force of 1 lie between 23.9 and 24.0.
    """
    poisson, thickness = 1 / 3, 1.0
    material = Yeoh(c1_mpa=1 / (4 * (1 + poisson)), c2_mpa=0.0, poisson=poisson)
    held = body(panel(8 if quick else 16, thickness), "hex27_p1", material, {"left": "xy", "face": "z"})
    equilibrium = pulled(held, "right", (0.0, 1 / 16, 0.0))  # a force of 1 N per mm of thickness
    free, solver = equilibrium.free, symmetric_solver()
    balance = equilibrium.balance(np.zeros(free.shape), {"pull": 1.0}, stiffness=True)
    solver.factorise(balance.stiffness)
    displacement = np.zeros(free.shape)
    displacement[free] = solver.solve(-balance.forces[free])
    solver.close()
    positions = equilibrium.solid.discretisation.positions
    middle = int(np.argmin(np.linalg.norm(positions - [48, 52, 0], axis=1)))
    yield Check(
        "u_y in the middle of the right edge (48, 52) [mm]", 23.96, float(displacement[middle, 1]), 0.005 * 23.96,
        "P. G. Bergan, C. A. Felippa 1985, as widely quoted",
    )  # fmt: skip


@benchmark("Cook's membrane, finite strain, plane strain", quick=True)
def membrane(quick: bool) -> Iterator[Check]:
    """How far the upper right corner rises, of a nearly incompressible panel at finite strain."""
    cells = 6 if quick else 12
    ratio = BULK_MODULUS_MPA / SHEAR_MODULUS_MPA
    material = Yeoh(SHEAR_MODULUS_MPA / 2, 0.0, 0.0, poisson=(3 * ratio - 2) / (6 * ratio + 2))
    equilibrium = body(panel(cells, 48.0 / cells), "hex27_p1", material, {"left": "xy", "body": "z"})
    loaded = pulled(equilibrium, "right", (0.0, FORCE_N_MM / 16, 0.0))
    displacement = raise_load(loaded, Ramp({"pull": 1.0}), 1.0, 0.1).displacements[-1]
    positions = equilibrium.solid.discretisation.positions
    corner = int(np.argmin(np.linalg.norm(positions - [48, 60, 0], axis=1)))
    yield Check(
        "u_y of the corner (48, 60) [mm]", 6.891, float(displacement[corner, 1]), 0.07,
        "OpenGeoSys, F-bar, 30 × 30 elements (after de Souza Neto et al. 1996)",
    )  # fmt: skip
