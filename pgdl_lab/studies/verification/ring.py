"""A thin ring buckles under pressure from outside; the load stiffness decides at which."""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import bisect
from skfem import MeshHex

from pgdl_lab.mechanics.assembly import Assembler
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.term import Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, curved, raise_load

RADIUS_MM, THICKNESS_MM, POISSON = 10.0, 0.1, 0.3
MATERIAL = Yeoh(c1_mpa=100.0, c2_mpa=0.0, poisson=POISSON)
YOUNG_MPA = 2 * MATERIAL.shear_modulus_mpa * (1 + POISSON)
UNIT_MPA = YOUNG_MPA / (1 - POISSON**2) * THICKNESS_MM**3 / 12 / RADIUS_MM**3  # E I / R³ in plane strain


def quarter(cells: int, element: str) -> Equilibrium:
    """A quarter of the ring; pressure acts from outside."""
    block = MeshHex.init_tensor(
        RADIUS_MM + THICKNESS_MM * np.array([-0.5, 0.5]), np.linspace(0, np.pi / 2, cells + 1), np.array([0.0, 0.2])
    )
    named = {
        "cavity": lambda x: np.isclose(x[0], RADIUS_MM + THICKNESS_MM / 2),
        "x-axis": lambda x: np.isclose(x[1], 0),
        "y-axis": lambda x: np.isclose(x[1], np.pi / 2),
    }
    mesh = curved(block, named, lambda x: np.array([x[0] * np.cos(x[1]), x[0] * np.sin(x[1]), x[2]]))
    return body(mesh, element, MATERIAL, {"x-axis": "y", "y-axis": "x", "body": "z"})


def critical(equilibrium: Equilibrium, load_stiffness: bool) -> float:
    """Pressure over E I / R³ at which the smallest eigenvalue of the stiffness changes its sign [–]."""
    branch = raise_load(equilibrium, Ramp({"air": 1.0}), 6 * UNIT_MPA, 0.5 * UNIT_MPA)
    assembler = Assembler([equilibrium.solid.discretisation.nodes], equilibrium.free)
    solver = symmetric_solver()

    def stable(pressure: float) -> float:
        displacement = branch.at(pressure * UNIT_MPA)
        if load_stiffness:
            whole = equilibrium.balance(displacement, {"air": pressure * UNIT_MPA}, stiffness=True)
            solver.factorise(whole.stiffness)
        else:
            solid = equilibrium.solid.response(displacement, stiffness=True)
            assert solid.stiffness is not None
            solver.factorise(assembler.upper(solid.stiffness))
        return -1.0 if solver.negative else 1.0

    try:
        return float(bisect(stable, 1.0, 6.0, xtol=1e-3))
    finally:
        solver.close()


@benchmark("ring buckling under outer pressure", quick=True)
def ring(quick: bool) -> Iterator[Check]:
    """Follow the round ring and look for the sign change, with the load stiffness and without it."""
    cells = 12 if quick else 32
    for element in ("hex20",) if quick else ("hex20", "hex27_p1"):
        equilibrium = quarter(cells, element)
        for load_stiffness, reference, what in (
            (True, 3.0, "critical pressure"),
            (False, 4.0, "the same without load stiffness, which is that of a load of fixed direction"),
        ):
            yield Check(
                f"{element}: {what}, over E I / R³ [–]", reference, critical(equilibrium, load_stiffness), 0.06,
                "S. P. Timoshenko, J. M. Gere, Theory of Elastic Stability, 1961",
            )  # fmt: skip
