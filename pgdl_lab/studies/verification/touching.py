"""Contact of two bodies: a patch test across unlike meshes, and a cylinder on a block."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex

from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.newton import NoConvergence
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, curved, nodes_on, reaction, settle

Array = NDArray[np.float64]

SMALLEST_STEP = 1e-3  # of the whole way
GAP_REACHES = 2.5  # distance of the bodies at rest, in reaches of the contact
HERTZ_RADIUS_MM, HALF_WIDTH_MM, BLOCK_MM = 20.0, 1.0, 12.0


def press(equilibrium: Equilibrium, way_mm: float, first: float) -> Array:
    """Displacement (N, 3) [mm] after the boundary `top` has come down by `way_mm` [mm].

    Steps, the `first` as a fraction of the way, are halved where Newton's method fails.
    """
    top, rest = nodes_on(equilibrium, "top"), np.zeros(equilibrium.free.shape)
    done, found, step = [0.0], [rest], first
    while done[-1] < 1:
        target = min(1.0, done[-1] + step)
        guess = found[-1].copy()
        if len(done) > 1:
            onward = (found[-1] - found[-2]) * (target - done[-1]) / (done[-1] - done[-2])
            guess += equilibrium.free_step(guess, onward) * onward
        guess[top, 1] = -target * way_mm
        try:
            found.append(settle(equilibrium, guess))
        except NoConvergence:
            step /= 2
            if step < SMALLEST_STEP:
                raise
        else:
            done.append(target)
            step *= 1.5
    return found[-1]


def blocks(grids: tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]) -> MeshHex:
    """Two blocks from their grid lines along x, y and z [mm], the second above the first, in one mesh."""
    return MeshHex.init_tensor(*grids[0]) + MeshHex.init_tensor(*grids[1])


@benchmark("two bodies in contact, unlike meshes", quick=True)
def patch(quick: bool) -> Iterator[Check]:
    """Press two cubes of unlike meshes together between rigid walls: uniaxial strain, and uniform.

    A barrier between samples of the surfaces passes such a test only on average: its forces on the nodes of a face are
    not quite those of a uniform pressure on quadratic shape functions. With three samples to an edge the pressure is
    within 0.1 %, and the interface within 1 % of the way; with two, 0.5 and 12 %.
    """
    reach, way = 1e-3, 0.1
    lines = [np.linspace(0, 1, cells + 1) for cells in (3, 4)]
    gap = GAP_REACHES * reach
    block = blocks(((lines[0],) * 3, (lines[1], lines[1] + 1 + gap, lines[1])))
    mesh = block.with_boundaries(
        {
            "bottom": lambda x: np.isclose(x[1], 0),
            "top": lambda x: np.isclose(x[1], 2 + gap),
            "sides": lambda x: (np.abs(x[[0, 2]] - 0.5) > 0.49).any(axis=0),
        }
    )
    material = Yeoh(poisson=0.4)
    held = {"bottom": "y", "top": "y", "body": "xz"}
    equilibrium = body(
        mesh, "hex27_p1", material, held,
        lambda elements: Contact(elements, reach, material.shear_modulus_mpa, "on", cut=("sides",)),
    )  # fmt: skip
    displacement = press(equilibrium, way, 0.05)
    contact = equilibrium.contact
    assert contact is not None
    left = contact.gap_mm(displacement)
    stretch = 1 - (way - gap + left) / 2
    invariant = stretch ** (-2 / 3) * (stretch**2 + 2)
    slope, _ = material.derivatives(np.array(invariant))
    nominal = 2 * float(slope) * (stretch ** (1 / 3) - invariant / 3 / stretch) + material.bulk_modulus_mpa * (
        stretch - 1
    )
    push = reaction(equilibrium, displacement, nodes_on(equilibrium, "top"))[1]
    yield Check("pressure between the bodies [MPa]", -nominal, -float(push), 1e-3 * abs(nominal), "closed form")
    lift = reaction(equilibrium, displacement, nodes_on(equilibrium, "bottom"))[1]
    yield Check("sum of both reactions over one [–]", 0.0, float(abs((push + lift) / push)), 1e-6, "equilibrium")
    height = equilibrium.solid.discretisation.positions[:, 1]
    face = displacement[np.isclose(height, 1), 1]
    yield Check(
        "unevenness of the interface over the way [–]",
        0.0,
        float(np.ptp(face) / way),
        0.01,
        "0 for uniform strain",
    )


@benchmark("Hertz, cylinder on block", quick=False)
def hertz(quick: bool) -> Iterator[Check]:
    """Press half a cylinder on a block of the same material, in plane strain.

    The half width a is that of the elliptic distribution with the same second moment as the contact forces found,
    a² = 4 ∫ p x² dx / ∫ p dx; it is to be that of the force found, a² = 4 F R / (π E*) with E* = E / (2 (1 − ν²)).
    """
    reach, poisson = 2e-3, 0.3
    material = Yeoh(c1_mpa=100.0, c2_mpa=0.0, poisson=poisson)
    young = 2 * material.shear_modulus_mpa * (1 + poisson)
    fine = np.linspace(0, 1.5 * HALF_WIDTH_MM, 9)
    coarse = np.geomspace(1, BLOCK_MM / fine[-1], 7)[1:] * fine[-1]
    deep = np.concatenate([[0.0], np.geomspace(0.2, BLOCK_MM, 7)])
    width, thick = np.concatenate([fine, coarse]), np.array([0.0, 0.2])
    gap = GAP_REACHES * reach
    block = blocks(((width, -deep[::-1], thick), (np.concatenate([fine * 0.97, coarse]), deep + gap, thick)))
    named = {
        "axis": lambda x: np.isclose(x[0], 0),
        "bottom": lambda x: np.isclose(x[1], -BLOCK_MM),
        "top": lambda x: np.isclose(x[1], BLOCK_MM + gap),
        "sides": lambda x: np.isclose(x[2], 0) | np.isclose(x[2], thick[-1]),
    }

    def place(x: Array) -> Array:
        rise = HERTZ_RADIUS_MM - np.sqrt(HERTZ_RADIUS_MM**2 - x[0] ** 2)
        share = np.where(x[1] > gap / 2, (BLOCK_MM + gap - x[1]) / BLOCK_MM, 0.0)
        return np.array([x[0], x[1] + share * rise, x[2]])

    equilibrium = body(
        curved(block, named, place), "hex27_p1", material, {"axis": "x", "bottom": "y", "top": "xy", "body": "z"},
        lambda elements: Contact(elements, reach, young, "on", cut=("axis", "sides")),
    )  # fmt: skip
    positions = equilibrium.solid.discretisation.positions
    below = positions[:, 1] < gap / 2
    for way in (0.05, 0.09):
        displacement = press(equilibrium, way, 0.03)
        top = reaction(equilibrium, displacement, nodes_on(equilibrium, "top"))
        force = -2 * float(top[1]) / thick[-1]
        half_width = (4 * force * HERTZ_RADIUS_MM * 2 * (1 - poisson**2) / (np.pi * young)) ** 0.5
        pushes = equilibrium.terms["contact"].response(displacement, stiffness=False).forces[below, 1]
        x = (positions + displacement)[below, 0]
        found = 2 * float((pushes * x**2).sum() / pushes.sum()) ** 0.5
        yield Check(
            f"half width of contact at {force:.3g} N/mm [mm]", half_width, found, 0.02 * half_width,
            "H. Hertz 1882; K. L. Johnson, Contact Mechanics, 1985, section 4.2",
        )  # fmt: skip
    share = 2 * abs(float(pushes.sum())) / thick[-1] / force
    yield Check("force between the bodies over the load [–]", 1.0, share, 1e-6, "equilibrium")
