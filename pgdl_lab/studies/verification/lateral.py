"""A tall strip held at one end and loaded at the other gives way sideways: seen from half its thickness alone."""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import bisect
from skfem import MeshHex

from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.term import Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, pulled, raise_load

LENGTH_MM, DEPTH_MM, THICKNESS_MM = 400.0, 5.0, 0.25
MATERIAL = Yeoh(c1_mpa=1.0, c2_mpa=0.0, poisson=0.0)
BENDING = 2 * MATERIAL.shear_modulus_mpa * DEPTH_MM * THICKNESS_MM**3 / 12  # E I about the weak axis, E = 2 μ [N mm²]
TORSION = MATERIAL.shear_modulus_mpa * DEPTH_MM * THICKNESS_MM**3 / 3 * (1 - 0.63 * THICKNESS_MM / DEPTH_MM)  # G J
UNIT_N = (BENDING * TORSION) ** 0.5 / LENGTH_MM**2
SLIM = (THICKNESS_MM / DEPTH_MM) ** 2  # E I about the weak axis over that about the strong one
STRONG = BENDING / SLIM


def half_strip(cells: int, element: str) -> Equilibrium:
    """The half y ≥ 0 of the strip along x; at a pull of 1 its end bears half of `UNIT_N`."""
    # torsion fades within a thickness of the edges, and takes fine elements there
    heights = DEPTH_MM / 2 - THICKNESS_MM * np.array([DEPTH_MM / 2 / THICKNESS_MM, 2.0, 1.0, 0.5, 0.0])
    mesh = MeshHex.init_tensor(
        np.linspace(0, LENGTH_MM, cells + 1),
        np.array([0.0, THICKNESS_MM / 2]),
        np.concatenate([-heights[:0:-1], heights]),
    ).with_boundaries({
        "root": lambda x: np.isclose(x[0], 0),
        "tip": lambda x: np.isclose(x[0], LENGTH_MM),
        "plane": lambda x: np.isclose(x[1], 0),
    })  # fmt: skip
    equilibrium = body(mesh, element, MATERIAL, {"root": "xyz", "plane": "y"}, sideways={"root": "xyz", "plane": "xz"})
    return pulled(equilibrium, "tip", (0.0, 0.0, -UNIT_N / (DEPTH_MM * THICKNESS_MM)))


def critical(equilibrium: Equilibrium) -> float:
    """The pull at which the smallest eigenvalue of the stiffness against antisymmetric motions changes its sign."""
    branch, solver = raise_load(equilibrium, Ramp({"pull": 1.0}), 6.0, 2.0), symmetric_solver()

    def stable(pull: float) -> float:
        solver.factorise(equilibrium.sideways_stiffness(branch.at(pull), {"pull": pull}))
        return -1.0 if solver.negative else 1.0

    try:
        return float(bisect(stable, 1.0, 6.0, xtol=1e-3))
    finally:
        solver.close()


@benchmark("sideways buckling of a cantilever", quick=True)
def lateral(quick: bool) -> Iterator[Check]:
    """Raise the load at the end of half a strip until the whole one would give way.

    The closed form lets the root warp; held flat, it makes the strip stiffer as if it were shorter by half its depth.
    """
    exact = 4.0126 / ((1 - SLIM) * (1 - TORSION / STRONG)) ** 0.5  # the strip sags before it gives way
    for element, cells in (("hex20", 20),) if quick else (("hex20", 40), ("hex27_p1", 80)):
        found = critical(half_strip(cells, element))
        yield Check(
            f"{element}: critical load, over √(E I G J) / L² [–]", exact, found, 0.05,
            "L. Prandtl 1899, A. G. M. Michell 1899 (Timoshenko and Gere 1961, § 6.4)",
        )  # fmt: skip
