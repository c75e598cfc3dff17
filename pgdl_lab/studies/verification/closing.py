"""A C that closes on itself, beside half of it: held where the ends would meet, and meeting its mirror image."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex, MeshHex2

from pgdl_lab.mechanics.contact import Contact
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.term import DeadLoad, Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, curved, nodes_on, raise_load, reaction, settle

Array = NDArray[np.float64]

RADIUS_MM, WALL_MM, DEPTH_MM = 10.0, 1.0, 0.5
GAP_MM, REACH_MM = 1.0, 0.02
ROUNDING_MM = 0.05  # how far the middle of an end stands out
CELLS = 12  # along half of the C
PULL_N_MM3 = 2.5e-6  # of each half towards the other
PULL = Ramp({"pull": 1.0})


def c_shape(stop: float) -> MeshHex2:
    """The C from one end, 0, to `stop` of its length: held at its back, in whose plane, y = 0, a half is cut off."""
    along = np.linspace(0, stop, round(2 * stop * CELLS) + 1)
    block = MeshHex.init_tensor(along, np.array([0.0, DEPTH_MM]), np.linspace(-0.5, 0.5, 3))
    named = {
        "back": lambda x: (np.abs(x[0] - 0.5) < 0.6 / CELLS) & np.isclose(x[2], 0.5),
        "end": lambda x: np.isclose(x[0], 0),
        "symmetry": lambda x: np.isclose(x[0], 0.5),
    }

    def place(x: Array) -> Array:
        half_opening = np.arcsin(GAP_MM / 2 / RADIUS_MM) + 4 * x[2] ** 2 * ROUNDING_MM / RADIUS_MM
        angle, radius = half_opening + x[0] * (2 * np.pi - 2 * half_opening), RADIUS_MM + WALL_MM * x[2]
        return np.array([radius * np.cos(angle), radius * np.sin(angle), x[1]])

    return curved(block, named, place)


def pulled(equilibrium: Equilibrium) -> Equilibrium:
    """`equilibrium` with the dead load "pull" of each half towards the other."""
    mesh = equilibrium.solid.discretisation
    side = np.sign(mesh.positions[:, [1]].round(9))
    return equilibrium.with_terms(pull=DeadLoad(-side * mesh.nodal_volumes()[:, None] * [0.0, PULL_N_MM3, 0.0]))


@benchmark("C closing on itself", quick=False)
def closing(quick: bool) -> Iterator[Check]:
    """By symmetry one half, whose end is held in the plane of symmetry, presses on it as the ends press on each other.

    That knows nothing of the barrier, but holds one line of nodes where contact spreads over some tenths of a
    millimetre, of an arm some twenty long: 2 % for the force.
    """
    material = Yeoh()
    make = partial(Contact, reach_mm=REACH_MM, stiffness_mpa=material.shear_modulus_mpa / 40, mode="on")
    clamped, cut = {"back": "xy", "body": "z"}, {"symmetry": "y"}
    whole = pulled(body(c_shape(1.0), "hex27_p1", material, clamped, make))
    found = raise_load(whole, PULL, 1.0, 0.1).displacements[-1]
    contact, at = whole.contact, whole.solid.discretisation.positions
    assert contact is not None
    pushes = contact.response(found, stiffness=False).forces[:, 1]

    half = pulled(body(c_shape(0.5), "hex27_p1", material, clamped | cut))
    positions = half.solid.discretisation.positions
    end = nodes_on(half, "end")
    end = end[np.isclose(np.linalg.norm(positions[end][:, :2], axis=1), RADIUS_MM)]
    same = np.array([np.argmin(np.linalg.norm(at - x, axis=1)) for x in positions])
    guess = found[same]
    guess[end, 1] = contact.gap_mm(found) / 2 - positions[end, 1]
    free = half.free.copy()
    free[end, 1] = False
    held = Equilibrium(half.terms, free)
    expected = settle(held, guess, PULL.at(1.0))
    force = float(reaction(held, expected, end, PULL.at(1.0))[1])
    push = -float(pushes[at[:, 1] > 0].sum())
    source = "half of it, held in the plane of symmetry"
    yield Check("force between the ends [N/mm]", force / DEPTH_MM, push / DEPTH_MM, 0.02 * force / DEPTH_MM, source)
    top = int(np.argmin(np.linalg.norm(positions - [0, RADIUS_MM, 0], axis=1)))
    sinks = -float(expected[top, 1])
    yield Check("descent of the top [mm]", sinks, -float(found[same[top], 1]), 0.02 * sinks, source)
    yield Check(
        "sum of the forces on both ends over one [–]", 0.0, abs(float(pushes.sum())) / push, 1e-6, "equilibrium"
    )

    mirrored = pulled(body(c_shape(0.5), "hex27_p1", material, clamped | cut, make))
    reflected = raise_load(mirrored, PULL, 1.0, 0.1).displacements[-1]
    push = -float(mirrored.terms["contact"].response(reflected, stiffness=False).forces[:, 1].sum())
    yield Check("force on the mirror image [N/mm]", force / DEPTH_MM, push / DEPTH_MM, 0.02 * force / DEPTH_MM, source)
    yield Check("descent of the top of the half [mm]", sinks, -float(reflected[top, 1]), 0.02 * sinks, source)
