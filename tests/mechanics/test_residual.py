"""The forces out of balance: none at simulated equilibria, right derivatives, a size that is a work."""

import numpy as np
import pytest

from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.residual import Residual
from tests.fingers import OBSERVATION, pneunet, solid
from tests.mechanics.test_inner_contact import slotted, squeezed

KPA = 10.0


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(pneunet(max_kpa=KPA), 6.0, "hex27_p1")


@pytest.fixture(scope="module")
def residual(model: Model) -> Residual:
    return Residual(model.equilibrium)


def test_simulated_equilibria_are_in_balance_to_the_tolerance_of_the_solver(model: Model, residual: Residual) -> None:
    """As a simulation hands them out, at each of its pressures; the forces at rest are those of the loads."""
    body = solid(element="hex27_p1").simulate(model.finger, OBSERVATION).body
    assert body is not None and len(body.pressures_kpa) > 3
    rest = np.zeros_like(model.discretisation.positions)
    for kpa, displacement in zip(body.pressures_kpa, body.displacements, strict=True):
        load = model.amplitudes(kpa)
        loads = residual.size(residual.forces(rest, load))
        assert residual.size(residual.forces(displacement, load)) < 1e-13 * loads
        off = residual.forces(1.001 * displacement, load)
        assert residual.size(off) > 1e-8 * loads
        assert not off[~model.equilibrium.free].any()


def test_backward_is_the_derivative_of_the_size(model: Model, residual: Residual) -> None:
    """Along displacements of all nodes, of those that are held too."""
    random, step, load = np.random.default_rng(0), 1e-6, {"weight": 1.0, "air": 0.02}
    at, direction = (0.05 * random.normal(size=model.equilibrium.free.shape) for _ in range(2))
    forces = residual.forces(at, load)
    gradient = residual.backward(at, load, 2 * residual.compliance(forces))
    after, before = (residual.size(residual.forces(at + s * step * direction, load)) for s in (1, -1))
    assert float((gradient * direction).sum()) == pytest.approx((after - before) / (2 * step), rel=1e-6)
    held = direction * ~model.equilibrium.free
    after, before = (residual.size(residual.forces(at + s * step * held, load)) for s in (1, -1))
    assert float((gradient * held).sum()) == pytest.approx((after - before) / (2 * step), rel=1e-5)
    assert abs((gradient * held).sum()) > 1e-3 * np.abs(gradient).max() * np.abs(held).max()


def test_backward_is_the_stiffness_that_is_factorised_with_contact_too() -> None:
    model = Model(slotted(gravity_m_s2=[3.0, -9.0], density_kg_m3=1e6), 0.0, "hex20", "on")
    free, load, random = model.equilibrium.free, {"weight": 0.7, "air": 0.03}, np.random.default_rng(0)
    at, vector = squeezed(model.discretisation, 0.01, 2.0), random.normal(size=free.shape)
    assert model.contact.near(at)
    upper = model.equilibrium.balance(at, load, stiffness=True).stiffness.toarray()
    known = (upper + np.triu(upper, 1).T) @ vector[free]
    found = Residual(model.equilibrium).backward(at, load, vector)[free]
    np.testing.assert_allclose(found, known, atol=1e-10 * np.abs(known).max())


def test_the_size_is_the_work_of_a_small_load(model: Model, residual: Residual) -> None:
    """Twice the energy that it leaves behind, which the solid tells by itself."""
    rest, load = np.zeros_like(model.discretisation.positions), {"air": 1e-7}
    forces = residual.forces(rest, load)
    moved = -residual.compliance(forces)
    stored = model.equilibrium.balance(moved, {}, stiffness=False).energy
    assert residual.size(forces) == pytest.approx(2 * stored, rel=1e-3)
