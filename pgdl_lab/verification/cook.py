"""Cook's membrane at finite strain, nearly incompressible."""

from collections.abc import Iterator

import numpy as np
from skfem import MeshHex

from pgdl_lab.mechanics.equilibrium import Load
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.verification.benchmark import Check, benchmark
from pgdl_lab.verification.bodies import body, nodal_areas, raise_load

SHEAR_MODULUS_MPA, BULK_MODULUS_MPA = 80.1938, 40.0942e4
FORCE_N_MM = 100.0  # per thickness


@benchmark("Cook's membrane, finite strain, plane strain", quick=True)
def membrane(quick: bool) -> Iterator[Check]:
    """A tapered panel held on the left and sheared on the right; how far its upper right corner rises."""
    cells = 6 if quick else 12
    grid = np.linspace(0, 1, cells + 1)
    block = MeshHex.init_tensor(grid, grid, np.array([0.0, 48.0 / cells]))
    s, t, z = block.p
    mesh = MeshHex(np.array([48 * s, 44 * s + t * (44 - 28 * s), z]), block.t).with_boundaries(
        {"left": lambda x: np.isclose(x[0], 0), "right": lambda x: np.isclose(x[0], 48)}
    )
    ratio = BULK_MODULUS_MPA / SHEAR_MODULUS_MPA
    material = Yeoh(SHEAR_MODULUS_MPA / 2, 0.0, 0.0, poisson=(3 * ratio - 2) / (6 * ratio + 2))
    equilibrium = body(mesh, "hex27_p1", material, {"left": "xy", "body": "z"})
    areas = nodal_areas(equilibrium, "right")
    equilibrium.weight[:, 1] = FORCE_N_MM / 16 * areas  # a dead load
    displacement = raise_load(equilibrium, lambda w: Load(w, 0.0), 1.0, 0.1).displacements[-1]
    positions = equilibrium.solid.discretisation.positions
    corner = int(np.argmin(np.linalg.norm(positions - [48, 60, 0], axis=1)))
    yield Check(
        "u_y of the corner (48, 60) [mm]", 6.891, float(displacement[corner, 1]), 0.07,
        "OpenGeoSys, F-bar, 30 × 30 elements (after de Souza Neto et al. 1996)",
    )  # fmt: skip
