"""The whole solid: Newton's method, the reference finger, and snapshots against equilibria solved for one by one."""

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.mechanics import path
from pgdl_lab.mechanics.equilibrium import Balance
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.linear import SuperLU
from pgdl_lab.mechanics.loading import unborne
from pgdl_lab.mechanics.newton import NoConvergence, solve
from pgdl_lab.mechanics.path import Branch
from pgdl_lab.mechanics.term import Amplitudes
from tests.fingers import balloon, pneunet


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(pneunet(), 6.0, "hex27_p1")


def test_tangent_against_differences(model: Model) -> None:
    """The whole stiffness, load stiffness included, is the derivative of the residual, and that of the energy."""
    free, random, step, load = model.equilibrium.free, np.random.default_rng(0), 1e-6, {"weight": 1.0, "air": 0.03}
    at, direction = 0.02 * random.normal(size=free.shape) * free, random.normal(size=free.shape) * free
    here = model.equilibrium.balance(at, load, stiffness=True)
    above, below = (model.equilibrium.balance(at + s * direction, load, stiffness=False) for s in (step, -step))
    change = (above.forces - below.forces)[free] / (2 * step)
    assert here.stiffness is not None
    stiffness = here.stiffness + sp.triu(here.stiffness, 1).T
    np.testing.assert_allclose(stiffness @ direction[free], change, atol=1e-8 * np.abs(change).max())
    slope = (above.energy - below.energy) / (2 * step)
    assert slope == pytest.approx(float((here.forces * direction).sum()), rel=1e-6)


def test_newton_converges_quadratically_and_both_solvers_agree(model: Model) -> None:
    rest, load = np.zeros(model.equilibrium.free.shape), {"weight": 1.0, "air": 0.005}
    loose, closer = (solve(model.equilibrium, model.solver, rest, load, tolerance) for tolerance in (1e-2, 1e-4))
    tight = solve(model.equilibrium, SuperLU(), rest, load, 1e-10)
    assert np.abs(loose.displacement - tight.displacement).max() < 1e-3
    assert np.abs(closer.displacement - tight.displacement).max() < 1e-7
    assert tight.iterations <= loose.iterations + 3
    assert np.abs(model.equilibrium.balance(tight.displacement, load, stiffness=False).forces).max() > 1e-3  # reactions
    held = ~model.equilibrium.free
    assert (tight.displacement[held] == 0).all()


def test_newton_does_not_end_with_a_step_that_was_damped() -> None:
    """Newton's steps to the minimum of a (a² + x²)^½ [N mm] lead farther away from where |x| > a."""

    class Cone:
        free = np.array([[True, False, False]])

        def balance(self, displacement: np.ndarray, amplitudes: Amplitudes, *, stiffness: bool) -> Balance:
            x, a = displacement[0, 0], 0.01
            root = np.hypot(a, x)
            return Balance(a * root, np.array([[a * x / root, 0, 0]]), sp.csr_matrix([[a**3 / root**3]]))

        def free_step(self, displacement: np.ndarray, correction: np.ndarray) -> float:
            return 1.0

    cone: Any = Cone()
    found = solve(cone, SuperLU(), np.array([[-0.029158, 0, 0]]), {}, 0.05)
    assert abs(found.displacement[0, 0]) < 1e-3  # a damped last step left 2.8e-3 mm


def test_solver_is_closed_when_a_finger_does_not_bear_its_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    model, calls = Model(pneunet(gravity_m_s2=[0.0, -1e6]), 6.0, "hex20"), list[str]()
    for name in ("factorise", "solve", "close"):
        method = getattr(model.solver, name)
        monkeypatch.setattr(model.solver, name, lambda *a, m=method, n=name: (m(*a), calls.append(n))[0])
    monkeypatch.setattr(path, "SMALLEST_STEP", 1e-2)
    with pytest.raises(LabError, match="no equilibrium beyond .* of the finger's weight"):
        model.load(np.array([20.0]), 1e-6, 1e-3)
    assert "factorise" in calls and calls[-1] == "close"


def test_newton_gives_up_beyond_the_bursting_pressure() -> None:
    model = Model(balloon(), 6.0, "hex20")
    with pytest.raises(NoConvergence):
        solve(model.equilibrium, model.solver, np.zeros(model.equilibrium.free.shape), model.amplitudes(300.0), 1e-6)


def test_interpolated_snapshots_against_equilibria(model: Model) -> None:
    pressures = np.linspace(0.2, 20, 25)
    history = model.load(pressures, 1e-8, 1e-5)
    assert history.complete and history.interpolation_mm <= 1e-5
    for kpa in pressures:
        exact = solve(model.equilibrium, model.solver, history.at(kpa), model.amplitudes(kpa), 1e-8).displacement
        assert np.abs(history.at(kpa) - exact).max() <= 1e-5


def test_bound_of_snapshots_holds_where_surfaces_meet() -> None:
    """Each place that comes in touch is a kink in the path."""
    model = Model(pneunet(wall_mm=1.5, side_wall_mm=1.5, gap_mm=0.4, max_kpa=14.0), 6.0, "hex20", "auto")
    pressures = np.linspace(0.14, 14.0, 100)
    history = model.load(pressures, 1e-6, 1e-5)
    assert model.contact.active and history.interpolation_mm <= 1e-5
    for kpa in pressures[pressures > 9]:
        exact = solve(model.equilibrium, model.solver, history.at(kpa), model.amplitudes(kpa), 1e-8).displacement
        assert np.abs(history.at(kpa) - exact).max() <= 1e-5


def test_support_bears_weight_and_pressure(model: Model) -> None:
    history = model.load(np.array([20.0]), 1e-8, 1e-3)
    reaction, outer = model.reaction_and_load_n(history.branch.displacements[-1], 20.0)
    np.testing.assert_allclose(reaction[[0, 2]], -outer[[0, 2]], atol=1e-9)
    assert outer[2] == pytest.approx(-1130e-12 * 9810 * model.discretisation.weights.sum(), rel=1e-6)


def test_gravity_across_bends_the_whole_finger() -> None:
    """Pulled to one side or the other, the finger is its own mirror image, and the support bears the weight."""
    bent = {}
    for sign in (1, -1):
        model = Model(pneunet(gravity_m_s2=[0.0, sign * 9.81, 0.0]), 6.0, "hex27_p1")
        assert "symmetry" not in model.mesh.boundaries
        history = model.load(np.array([20.0]), 1e-8, 1e-3)
        bent[sign] = history.at(20.0)
        reaction, outer = model.reaction_and_load_n(bent[sign], 20.0)
        np.testing.assert_allclose(reaction, -outer, atol=1e-9)
        assert outer[1] == pytest.approx(sign * 1130e-12 * 9810 * model.discretisation.weights.sum(), rel=1e-6)
    places = np.round(model.discretisation.positions, 6)
    there = np.lexsort(places.T), np.lexsort((places * [1, -1, 1]).T)
    np.testing.assert_allclose(places[there[0]], (places * [1, -1, 1])[there[1]], atol=1e-9)
    np.testing.assert_allclose(bent[1][there[0]], (bent[-1] * [1, -1, 1])[there[1]], atol=1e-6)
    end = np.isclose(model.discretisation.positions[:, 0], 22)
    assert bent[1][end, 1].mean() > 0.05  # the end goes along with the weight [mm]


def test_half_and_whole_finger_agree() -> None:
    """A pull along y that is next to nothing leaves the whole finger where the half finger is."""
    half, whole = (
        Model(pneunet(gravity_m_s2=gravity), 6.0, "hex27_p1") for gravity in ([0.0, -9.81], [0.0, 1e-9, -9.81])
    )
    ours, theirs = (model.load(np.array([20.0]), 1e-8, 1e-3).at(20.0) for model in (half, whole))
    front = np.flatnonzero(whole.discretisation.positions[:, 1] > -1e-9)
    assert len(front) == len(ours) < len(theirs)
    here, there = (
        np.lexsort(np.round(p, 6).T) for p in (half.discretisation.positions, whole.discretisation.positions[front])
    )
    np.testing.assert_allclose(ours[here], theirs[front][there], atol=1e-6)


def test_half_a_finger_cannot_be_pulled_across() -> None:
    finger = pneunet(gravity_m_s2=[0.0, 9.81, 0.0])
    model = Model(pneunet(), 6.0, "hex20")
    model.finger = finger
    with pytest.raises(InputError, match="mesh the whole finger"):
        model.equilibrium_on(model.mesh)


def test_a_path_of_the_weight_that_ends_tells_what_happened() -> None:
    """Slopes that grow without bound mean a limit of the body, others that Newton's method found no further one."""
    at = [0.4, 0.4999, 0.5]
    turning = Branch(at, [np.zeros((1, 3))] * 3, [np.full((1, 3), (0.50005 - p) ** -0.5) for p in at])
    weight = {"weight": 1.0}
    assert unborne(turning, weight).startswith("The finger bears only 50.00% of its weight")
    assert unborne(turning, {**weight, "tip": 1.0}).startswith(
        "The finger bears only 50.00% of its loads (weight, tip)"
    )
    thrown = Branch([0.0, 0.02], [np.zeros((1, 3))] * 2, [np.ones((1, 3))] * 2)
    assert "no equilibrium beyond 2.00% of the finger's weight" in unborne(thrown, weight)


def test_weight_that_cannot_be_borne_is_named() -> None:
    with pytest.raises(
        LabError,
        match="beyond 0.0.% of the finger's weight, however small the step .*: it may bear no more",
    ):
        Model(pneunet(gravity_m_s2=[-9.81, 0.0], density_kg_m3=1e9), 6.0, "hex20").load(np.array([20.0]), 1e-6, 1e-3)


def test_reference_finger_against_calculix() -> None:
    """20-node elements of 3 mm at 30 kPa: extremes of CalculiX 2.20 (C3D20R) on the same mesh [mm], within 0.5 %."""
    model = Model(pneunet(chambers=10, max_kpa=30.0), 3.0, "hex20")
    history = model.load(np.array([30.0]), 1e-6, 1e-3)
    weight_only, full = history.at(0.0), history.at(30.0)
    assert weight_only[:, 2].min() == pytest.approx(-67.77, rel=5e-4)
    assert full[:, 0].min() == pytest.approx(-52.011, rel=5e-3)
    assert full[:, 0].max() == pytest.approx(7.768, rel=5e-3)
    assert full[:, 2].min() == pytest.approx(-95.121, rel=5e-3)
    assert full[:, 2].max() == pytest.approx(0.624, rel=5e-3)


@pytest.mark.parametrize(("element", "sag_mm"), [("hex20", -83.6), ("hex27", -79.7), ("hex27_p1", -92.4)])
def test_linear_sag_of_the_reference_finger(element: str, sag_mm: float) -> None:
    """Deflection of the tip per unit of gravity in a linear solve with one element across each wall."""
    model = Model(pneunet(chambers=10), 3.0, element)
    rest = np.zeros(model.equilibrium.free.shape)
    balance = model.equilibrium.balance(rest, model.amplitudes(0.0), stiffness=True)
    model.solver.factorise(balance.stiffness)
    rest[model.equilibrium.free] = -model.solver.solve(balance.forces[model.equilibrium.free])
    assert rest[:, 2].min() == pytest.approx(sag_mm, abs=0.06)
