from typing import Any

import numpy as np
import pytest

from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.finger_rod import FingerRod
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.lattice import Lattice
from pgdl_lab.mechanics.profile import Profile, Region
from pgdl_lab.mechanics.rod import Axis, rod
from pgdl_lab.mechanics.segments import between, columns, cuts
from pgdl_lab.mechanics.term import DeadLoad
from pgdl_lab.studies.verification.bodies import settle
from tests.fingers import pneunet

RANDOM = np.random.default_rng(0)
AXIS = Axis(np.array([0.0, 1.0, 1.5, 3.0, 4.0]))


def uneven() -> Equilibrium:
    """Four unlike elements with coupled stiffnesses, eccentric masses and air."""
    root = RANDOM.normal(size=(4, 3, 3))
    stiffness, air = root @ root.transpose(0, 2, 1), RANDOM.normal(size=(4, 3))
    return rod(AXIS, stiffness, air, RANDOM.random(4), RANDOM.normal(size=4), np.array([0.3, -2.0]))


def test_forces_and_stiffness_are_the_derivatives_of_the_energy() -> None:
    body, load = uneven(), {"weight": 0.7, "air": 0.4}
    assert body.balance(np.zeros((5, 3)), load, stiffness=False).energy == 0
    state = 0.3 * RANDOM.normal(size=(5, 3))
    here = body.balance(state, load, stiffness=True)
    assert here.stiffness is not None
    direction = RANDOM.normal(size=(5, 3)) * body.free
    step = 1e-5 * direction
    after, before = (body.balance(state + sign * step, load, stiffness=False) for sign in (1, -1))
    np.testing.assert_allclose((after.energy - before.energy) / 2e-5, (here.forces * direction).sum(), rtol=1e-7)
    upper = here.stiffness.toarray()
    full = upper + np.triu(upper, 1).T
    slope = ((after.forces - before.forces) / 2e-5)[body.free]
    np.testing.assert_allclose(full @ direction[body.free], slope, rtol=1e-6, atol=1e-6)


def test_the_forces_of_a_load_are_what_it_changes() -> None:
    body, state = uneven(), 0.3 * RANDOM.normal(size=(5, 3))
    for load in ({"air": 0.5}, {"weight": 2.0}):
        rest, loaded = (body.balance(state, given, stiffness=False).forces for given in ({}, load))
        np.testing.assert_allclose(body.drive(state, load), rest - loaded, atol=1e-12)


def test_strains_do_not_see_rigid_motion() -> None:
    angle, x = 0.8, AXIS.places
    state = np.column_stack([3 + x * (np.cos(angle) - 1), -2 + x * np.sin(angle), np.full(5, angle)])
    np.testing.assert_allclose(AXIS.strains(state), 0, atol=1e-14)


def lopsided(*gravity: float) -> Any:
    """A finger of one chamber above its middle, under the acceleration `gravity` along x and z [m/s²]."""
    return pneunet(chambers=1, root_mm=6.0, base_mm=6.0, gravity_m_s2=list(gravity))


def test_weight_does_the_work_that_it_does_in_the_solid() -> None:
    """As each section is carried along and turns about the axis by a parabola of x: along x only the lever works."""
    for gravity in ((9.81, 0.0), (0.0, -9.81)):
        model, body = FingerRod(lopsided(*gravity), 6.0, 0.25), Model(lopsided(*gravity), 6.0, "hex20")
        x = model.axis.places
        turned = np.column_stack([0 * x, x**3 / 3, x**2])
        unmoved = np.zeros_like(turned)
        forces = [model.equilibrium.balance(unmoved, {"weight": w}, stiffness=False).forces for w in (1.0, 0.0)]
        work = ((forces[1] - forces[0]) * turned).sum()
        x, _, z = body.discretisation.positions.T
        assert model.axis_mm == pytest.approx(np.average(z, weights=body.discretisation.nodal_volumes()))
        moved = np.column_stack([-(z - model.axis_mm) * x**2, 0 * x, x**3 / 3])
        known = 2 * (body.equilibrium.drive(moved, {"weight": 1.0}) * moved).sum()  # the mesh is half of the finger
        assert abs(known) > 1e-3
        np.testing.assert_allclose(work, known, rtol=5e-3)


def test_columns_shear_one_after_the_other() -> None:
    """Under a load at the tip: 5/6 of the area of each, as Timoshenko has it for a rectangle."""
    model, load = FingerRod(lopsided(0.0, 0.0), 6.0, 0.25), 1e-5
    forces = np.zeros(model.equilibrium.free.shape)
    forces[-1, 1] = load
    found = settle(model.equilibrium.with_terms(end=DeadLoad(forces)), np.zeros_like(forces), {"end": 1.0})
    sheared = (model.axis.strains(found)[:, 1] * model.axis.length).sum()
    full, hollow = 16.0 * 20.0, 16.0 * 20.0 - 10.0 * 11.0  # 9 and 3 mm of one, 4.5 mm of the other
    np.testing.assert_allclose(sheared, load * (12.0 / full + 4.5 / hollow) / (5 / 6 * 0.22), rtol=1e-3)


def test_fingers_are_cut_in_gaps_and_long_columns() -> None:
    profile = pneunet(root_mm=20.0).profile()
    np.testing.assert_allclose(cuts(profile), [0, 11.5, 31, 42])  # block and wall are one column of 23 mm
    piece = between(profile, 11.5, 31)
    assert [stop - start for start, stop, _ in columns(piece)] == [11.5, 4.5, 3.0, 0.5]


def test_interpolation_reproduces_quadratics_and_never_looks_into_gaps() -> None:
    profile = Profile(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 3.0]), np.array([[1, 0], [1, 1]], dtype=np.int8))
    lattice = Lattice(profile)
    x, z = (axis.ravel() for axis in np.meshgrid(lattice.x, lattice.z, indexing="ij"))
    values = 1 + x * z + z**2 - 0.5 * x**2 * z
    gap = lattice.places(*(np.array([index]) for index in np.argwhere(profile.regions == Region.GAP)[0]))
    values[np.setdiff1d(gap, lattice.places(np.array([0, 1, 1]), np.array([0, 0, 1])))] = np.nan
    points = np.array([[0.3, 1.9], [1.0, 2.0], [0.5, 2.0], [1.0, 2.7], [3.0, 3.0], [2.2, 2.4]])
    x, z = points.T
    np.testing.assert_allclose(
        lattice.interpolation(points) @ np.nan_to_num(values, nan=1e9), 1 + x * z + z**2 - 0.5 * x**2 * z
    )
    np.testing.assert_array_equal(lattice.nearest(lattice.x[[1, 4]], lattice.z[[2, 0]]), [1 * 5 + 2, 4 * 5])
