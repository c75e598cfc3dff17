"""Homogeneous strain: patch tests on distorted elements, stretching in closed form."""

from collections.abc import Callable, Iterator

import numpy as np

from pgdl_lab.core.registry import plugin
from pgdl_lab.mechanics.elements import ELEMENTS
from pgdl_lab.mechanics.material import Material, Yeoh
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, nodes_on, reaction, settle, wavy

STRAINED = np.array([[1.3, 0.2, -0.1], [0.0, 0.9, 0.25], [0.1, 0.0, 1.05]])
GRADIENT = 1.01 * STRAINED / np.linalg.det(STRAINED) ** (1 / 3) - np.eye(3)  # of the displacement; det F = 1.03
STRETCHES = (1.1, 1.25, 1.5, 2.0)
INCOMPRESSIBLE = 0.499999


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


# Each mode: the thinning k of the stretches λ, λ^side, λ^−k, and the sides that are pulled and held.
MODES = {
    "uniaxial": (0.5, -0.5, ""),
    "equibiaxial": (2.0, 1.0, "y"),
    "plane strain": (1.0, 0.0, "y"),
}


def laws() -> Iterator[tuple[str, Material, Callable[[float, float], float]]]:
    """Laws, nearly incompressible, with their nominal stress [MPa] for a stretch λ and a thinning k.

    Where I₁ and I₂ are the invariants, that of an incompressible solid is dW/dI₁ dI₁/dλ + dW/dI₂ dI₂/dλ, in
    equibiaxial tension half of that; Ogden's is Σ μ_i (λ^(α_i − 1) − λ^(−k α_i − 1)).
    """
    c1, c2, c10, c01 = 0.11, 0.02, 0.09, 0.02
    mu, alpha = [0.22, 0.044, -0.01], [1.0, 5.0, -2.0]

    def difference(stretch: float, k: float, power: float) -> float:
        return float(stretch ** (power - 1) - stretch ** (-k * power - 1))

    def invariant(stretch: float, k: float, power: float) -> float:
        return float(np.sum(np.array([stretch, stretch ** (k - 1), stretch**-k]) ** power))

    yield (
        "Yeoh", Yeoh(c1, c2, poisson=INCOMPRESSIBLE),
        lambda s, k: 2 * difference(s, k, 2) * (c1 + 2 * c2 * (invariant(s, k, 2) - 3)),
    )  # fmt: skip
    yield (
        "Mooney–Rivlin", plugin("material", "mooney_rivlin")(c10, c01, poisson=INCOMPRESSIBLE),
        lambda s, k: 2 * (c10 * difference(s, k, 2) - c01 * difference(s, k, -2)),
    )  # fmt: skip
    yield (
        "Ogden", plugin("material", "ogden")(mu, alpha, poisson=INCOMPRESSIBLE),
        lambda s, k: sum(m * difference(s, k, a) for m, a in zip(mu, alpha, strict=True)),
    )  # fmt: skip


@benchmark("homogeneous stretch", quick=True)
def stretch(quick: bool) -> Iterator[Check]:
    """Pull a cube whose sides are free (uniaxial), two of them pulled too (equibiaxial) or held (plane strain)."""
    mesh = wavy(2, "hex27_p1").with_boundaries(
        {
            f"{axis}{end}": lambda x, i=i, end=end: np.isclose(x[i], end)
            for i, axis in enumerate("xyz")
            for end in (0, 1)
        }
    )
    for law, material, closed_form in laws():
        for name, (thinning, side, pulled) in MODES.items():
            held = {f"{axis}0": axis for axis in "xyz"} | {f"{axis}1": axis for axis in "x" + pulled}
            equilibrium = body(mesh, "hex27_p1", material, held)
            positions, end = equilibrium.solid.discretisation.positions, nodes_on(equilibrium, "x1")
            for stretch in STRETCHES:
                scale = np.array([stretch, stretch**side, stretch**-thinning])
                displacement = settle(equilibrium, positions * (scale - 1))
                pull = reaction(equilibrium, displacement, end)[0]
                nominal = closed_form(stretch, thinning)
                yield Check(
                    f"{law}, {name}, stretch {stretch:g}: nominal stress [MPa]",
                    nominal, float(pull), 1e-4 * nominal, "closed form, incompressible",
                )  # fmt: skip
