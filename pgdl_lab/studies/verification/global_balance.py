"""Forces of the whole finger: the support holds its weight, and the air pushes nowhere but across the cut."""

from collections.abc import Iterator

import numpy as np

from pgdl_lab.core.registry import plugin
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.studies.verification.benchmark import Check, benchmark


@benchmark("reaction of a finger", quick=True)
def reaction(quick: bool) -> Iterator[Check]:
    """Half a finger of two chambers that points down at a slant, under its weight and full pressure."""
    finger = plugin("finger", "pneunet")(chambers=2, max_kpa=20.0, gravity_m_s2=[6.0, -8.0])
    model = Model(finger, 6.0, "hex27_p1")
    history = model.load(np.array([finger.max_kpa]), 1e-8, 1e-2)
    found, load = model.reaction_and_load_n(history.branch.displacements[-1], history.reached_kpa)
    volume = float(model.discretisation.weights.sum())
    gx, gz = finger.gravity_m_s2
    for axis, name, gravity in ((0, "x", gx), (2, "z", gz)):
        weight = 1e-9 * finger.density_kg_m3 * gravity * volume
        yield Check(f"reaction along {name} [N]", -weight, float(found[axis]), 1e-8, "weight ρ g V of the half finger")
        yield Check(f"weight and pressure along {name} [N]", weight, float(load[axis]), 1e-8, "closed cavities")
