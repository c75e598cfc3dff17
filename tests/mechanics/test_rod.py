import numpy as np

from pgdl_lab.mechanics.equilibrium import Load
from pgdl_lab.mechanics.lattice import Lattice
from pgdl_lab.mechanics.profile import Profile, Region
from pgdl_lab.mechanics.rod import Rod, Sections
from pgdl_lab.mechanics.segments import between, columns, cuts
from tests.fingers import pneunet

RANDOM = np.random.default_rng(0)


def rod() -> Rod:
    """Four unlike elements with coupled stiffnesses, eccentric masses and air."""
    root = RANDOM.normal(size=(4, 3, 3))
    sections = Sections(
        root @ root.transpose(0, 2, 1), RANDOM.normal(size=(4, 3)), RANDOM.random(4), RANDOM.normal(size=4)
    )
    return Rod(np.array([0.0, 1.0, 1.5, 3.0, 4.0]), sections, np.array([0.3, -2.0]))


def test_forces_and_stiffness_are_the_derivatives_of_the_energy() -> None:
    body, load = rod(), Load(0.7, 0.4)
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


def test_pressure_forces_are_what_the_pressure_changes() -> None:
    body, state = rod(), 0.3 * RANDOM.normal(size=(5, 3))
    rest, blown = (body.balance(state, Load(1.0, p), stiffness=False).forces for p in (0.0, 0.5))
    np.testing.assert_allclose(0.5 * body.pressure_forces(state), rest - blown, atol=1e-12)


def test_strains_do_not_see_rigid_motion() -> None:
    body, angle = rod(), 0.8
    x = body.nodes
    state = np.column_stack([3 + x * (np.cos(angle) - 1), -2 + x * np.sin(angle), np.full(5, angle)])
    np.testing.assert_allclose(body.strains(state), 0, atol=1e-14)


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
