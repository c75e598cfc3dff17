"""The energy of all that acts on a finger, and its derivatives."""

import numpy as np
import pytest

from pgdl_lab.mechanics.finite_strain import Model
from tests.mechanics.test_inner_contact import slotted, squeezed


@pytest.fixture(scope="module")
def model() -> Model:
    """A heavy prong with a chamber, whose contact with its mirror image acts."""
    return Model(slotted(gravity_m_s2=[3.0, -9.0], density_kg_m3=1e6), 0.0, "hex20", "on")


@pytest.mark.parametrize("load", [{}, {"weight": 1.0}, {"weight": 0.7, "air": 0.03}], ids=str)
@pytest.mark.parametrize("half_gap_mm", [0.3, 0.01])
def test_forces_and_stiffness_are_the_derivatives_of_the_energy(
    model: Model, half_gap_mm: float, load: dict[str, float]
) -> None:
    equilibrium, mesh, random, step = model.equilibrium, model.discretisation, np.random.default_rng(0), 1e-7
    at = squeezed(mesh, half_gap_mm, 2.0) + 1e-3 * random.normal(size=mesh.positions.shape)
    direction = random.normal(size=mesh.positions.shape)
    here = equilibrium.balance(at, load, stiffness=True)
    after, before = (equilibrium.balance(at + sign * step * direction, load, stiffness=False) for sign in (1, -1))
    slope = (after.energy - before.energy) / (2 * step)
    assert slope == pytest.approx(float((here.forces * direction).sum()), rel=1e-5)
    assert model.contact.near(at) == (half_gap_mm < 0.025)

    free = equilibrium.free
    after, before = (
        equilibrium.balance(at + sign * step * direction * free, load, stiffness=False) for sign in (1, -1)
    )
    change = ((after.forces - before.forces) / (2 * step))[free]
    given = equilibrium.with_terms(solid=equilibrium.solid.at_pressure(equilibrium.solid.pressure(at)))
    for balance in (here, given.balance(at, load, stiffness=True)):
        assert balance.stiffness is not None
        upper = balance.stiffness.toarray()
        found = (upper + np.triu(upper, 1).T) @ direction[free]
        np.testing.assert_allclose(found, change, atol=1e-6 * np.abs(change).max())
        np.testing.assert_allclose(balance.forces, here.forces, atol=1e-9 * np.abs(here.forces).max())


def test_sideways_stiffness_is_that_of_motions_which_carry_the_mirror_image_along(model: Model) -> None:
    """So contact with the image, which acts here, has no part in it; weight and air have theirs."""
    equilibrium, mesh, random, step = model.equilibrium, model.discretisation, np.random.default_rng(0), 1e-7
    at, load, free = squeezed(mesh, 0.01, 2.0), {"weight": 1.0, "air": 0.03}, equilibrium.sideways
    assert free is not None and model.contact.near(at)
    upper = equilibrium.sideways_stiffness(at, load).toarray()
    direction = random.normal(size=mesh.positions.shape) * free
    model.contact.active = False
    try:
        after, before = (equilibrium.balance(at + sign * step * direction, load, stiffness=False) for sign in (1, -1))
    finally:
        model.contact.active = True
    change = ((after.forces - before.forces) / (2 * step))[free]
    found = (upper + np.triu(upper, 1).T) @ direction[free]
    np.testing.assert_allclose(found, change, atol=1e-6 * np.abs(change).max())
