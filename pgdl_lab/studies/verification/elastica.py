"""Slender cantilevers in the plane: dead load at the tip, and a moment that closes the circle."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc
from skfem import MeshHex

from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.term import Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, nodes_on, pulled, raise_load, settle

Array = NDArray[np.float64]

LENGTH_MM, DEPTH_MM, WIDTH_MM = 100.0, 1.0, 1.0
MATERIAL = Yeoh(c1_mpa=1.0, c2_mpa=0.0, poisson=0.0)
BENDING_STIFFNESS = 2 * MATERIAL.shear_modulus_mpa * WIDTH_MM * DEPTH_MM**3 / 12  # E I [N mm²], E = 2 μ at ν = 0
LOADS = (1.0, 2.0, 5.0, 10.0)  # P L² / (E I)


def beam(cells: int, element: str, held: dict[str, str]) -> Equilibrium:
    """The cantilever along x, its axis on the x-axis, bending in the plane of x and y."""
    mesh = MeshHex.init_tensor(
        np.linspace(0, LENGTH_MM, cells + 1), DEPTH_MM * np.array([-0.5, 0.5]), np.array([0.0, WIDTH_MM])
    ).with_boundaries({"root": lambda x: np.isclose(x[0], 0), "tip": lambda x: np.isclose(x[0], LENGTH_MM)})
    return body(mesh, element, MATERIAL, held | {"body": "z"})


def elastica(load: float) -> tuple[float, float]:
    """Deflection and shortening of the inextensible cantilever over its length, for `load` = P L² / (E I).

    K. E. Bisshopp, D. C. Drucker, Quarterly of Applied Mathematics 3, 1945, with the modulus k as the unknown.
    """
    root = load**0.5

    def start(m: float) -> float:
        return float(np.arcsin((2 * m) ** -0.5))

    m = brentq(lambda m: ellipk(m) - ellipkinc(start(m), m) - root, 0.5 + 1e-12, 1 - 1e-12)  # m = k²
    deflection = 1 - 2 / root * (ellipe(m) - ellipeinc(start(m), m))
    return float(deflection), float(1 - (2 * (2 * m - 1)) ** 0.5 / root)


@benchmark("elastica, dead load at the tip", quick=True)
def tip_load(quick: bool) -> Iterator[Check]:
    """Raise the load; deflection and shortening of the axis at the tip."""
    for element, cells in (("hex20", 20),) if quick else (("hex20", 40), ("hex27_p1", 60)):
        equilibrium = beam(cells, element, {"root": "xy"})
        unit = BENDING_STIFFNESS / LENGTH_MM**2 / (DEPTH_MM * WIDTH_MM)
        loaded = pulled(equilibrium, "tip", (0.0, unit, 0.0))
        branch = raise_load(loaded, Ramp({"pull": 1.0}), LOADS[-1], 0.2)
        tip = nodes_on(equilibrium, "tip")
        for load in LOADS:
            moved = branch.at(load)[tip].mean(axis=0) / LENGTH_MM
            for name, reference, obtained in zip(("w/L", "u/L"), elastica(load), (moved[1], -moved[0]), strict=True):
                yield Check(
                    f"{element}, P L²/(E I) = {load:g}: {name} [–]", reference, float(obtained), 2e-3,
                    "elliptic integrals (Bisshopp and Drucker 1945)",
                )  # fmt: skip


@benchmark("end moment to a closed circle", quick=True)
def circle(quick: bool) -> Iterator[Check]:
    """Turn the end section by 360° onto the root; the support must answer with M = 2 π E I / L and no force.

    The section is put where pure bending of an inextensible axis takes it. Newton's method starts from that motion of
    the whole beam: from straight it would have to go through a long path.
    """
    equilibrium = beam(16 if quick else 40, "hex20", {"root": "xy", "tip": "xy"})
    radius = LENGTH_MM / (2 * np.pi)
    x, y, _ = equilibrium.solid.discretisation.positions.T
    angle = x / radius
    bent = np.column_stack([(radius - y) * np.sin(angle) - x, radius - (radius - y) * np.cos(angle) - y, 0 * x])
    displacement = settle(equilibrium, bent)
    tip = nodes_on(equilibrium, "tip")
    forces = equilibrium.balance(displacement, {}, stiffness=False).forces[tip]
    place = (equilibrium.solid.discretisation.positions + displacement)[tip]
    moment = (place[:, 0] * forces[:, 1] - place[:, 1] * forces[:, 0]).sum()
    exact = 2 * np.pi * BENDING_STIFFNESS / LENGTH_MM
    yield Check("moment at the end over E I / L [–]", 2 * np.pi, float(moment / exact * 2 * np.pi), 0.02, "M = E I κ")
    largest = float(np.abs(forces.sum(axis=0)).max() / (exact / LENGTH_MM))
    yield Check("force at the end over M / L [–]", 0.0, largest, 1e-3, "pure bending")
    axis = np.isclose(y, 0) & np.isclose(x, LENGTH_MM / 2)
    height = (y + displacement[:, 1])[axis].mean() / LENGTH_MM
    yield Check("diameter over length [–]", 1 / np.pi, float(height), 1e-3, "circle")
