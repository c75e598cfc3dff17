"""Homogeneous strain: patch tests on distorted elements, stretching in closed form."""

from collections.abc import Iterator

import numpy as np

from pgdl_lab.mechanics.elements import ELEMENTS
from pgdl_lab.mechanics.equilibrium import Load
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.verification.benchmark import Check, benchmark
from pgdl_lab.verification.bodies import body, nodes_on, reaction, settle, wavy

STRAINED = np.array([[1.3, 0.2, -0.1], [0.0, 0.9, 0.25], [0.1, 0.0, 1.05]])
GRADIENT = 1.01 * STRAINED / np.linalg.det(STRAINED) ** (1 / 3) - np.eye(3)  # of the displacement; det F = 1.03
STRETCHES = (1.1, 1.25, 1.5, 2.0)


@benchmark("patch test", quick=True)
def patch(quick: bool) -> Iterator[Check]:
    """Prescribe an affine displacement on the boundary and find it inside, from a disturbed start."""
    random = np.random.default_rng(0)
    for element in ELEMENTS:
        for size, name in ((1e-4, "linear"), (1.0, "finite strain")):
            equilibrium = body(wavy(3, element), element, Yeoh(), {"all": "xyz"})
            affine = size * equilibrium.solid.discretisation.positions @ GRADIENT.T
            disturbed = affine + size * 0.003 * random.normal(size=affine.shape) * equilibrium.free
            error = np.abs(settle(equilibrium, disturbed) - affine).max() / np.abs(affine).max()
            yield Check(f"{name}, {element}: error of displacement [–]", 0.0, float(error), 1e-9, "exact")


@benchmark("homogeneous stretch", quick=True)
def stretch(quick: bool) -> Iterator[Check]:
    """Pull a cube; its sides are free (uniaxial tension), or two of them are held (plane strain)."""
    material = Yeoh(poisson=0.499999)
    for name, thinning, sides in (("uniaxial", 0.5, ("y", "z")), ("plane strain", 1.0, ("z",))):
        mesh = wavy(2, "hex27_p1").with_boundaries(
            {
                f"{axis}{end}": lambda x, i=i, end=end: np.isclose(x[i], end)
                for i, axis in enumerate("xyz")
                for end in (0, 1)
            }
        )
        held = {"x0": "x", "x1": "x", "y0": "y", "z0": "z"} | ({"y1": "y"} if "y" not in sides else {})
        equilibrium = body(mesh, "hex27_p1", material, held)
        positions, pulled = equilibrium.solid.discretisation.positions, nodes_on(equilibrium, "x1")
        for stretch in STRETCHES:
            invariant = stretch**2 + (2 / stretch if len(sides) == 2 else 1 / stretch**2 + 1)
            slope = material.c1_mpa + 2 * material.c2_mpa * (invariant - 3)
            nominal = 2 * (stretch - stretch ** (-1 - 2 * thinning)) * slope
            lateral = stretch**-thinning
            scale = [stretch, lateral if "y" in sides else 1.0, lateral]
            displacement = settle(equilibrium, positions * (np.array(scale) - 1))
            pull = reaction(equilibrium, displacement, Load(0.0, 0.0), pulled)[0]
            yield Check(
                f"{name}, stretch {stretch:g}: nominal stress [MPa]",
                nominal, float(pull), 1e-4 * nominal, "closed form, incompressible Yeoh",
            )  # fmt: skip
