"""Newton's and the BFGS method on potentials whose lowest point is known, without any finite element."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pgdl_lab.mechanics import newton, quasi_newton
from pgdl_lab.mechanics.newton import NoConvergence, solve, step_length
from pgdl_lab.mechanics.solid import InvertedElement

Array = NDArray[np.float64]
SHAPE = 4, 3
FREE = np.arange(12).reshape(SHAPE) % 5 > 0
STIFF = np.linspace(1, 4, 12).reshape(SHAPE)
ROOTS = np.where(FREE, np.linspace(-2, 3, 12).reshape(SHAPE), 0.0)


class Springs:
    """Springs that harden, k u + c u³ = f, with the equilibrium `ROOTS`; some are held."""

    free = FREE

    def __init__(self, hard: float, far_mm: float = np.inf, reach: Callable[[Array, Array], float] | None = None):
        self.hard, self.far_mm, self.asked = hard, far_mm, 0
        self.force = STIFF * ROOTS + hard * ROOTS**3
        self.free_step = reach or (lambda displacement, correction: 1.0)

    def balance(self, u: Array, load: Any, *, stiffness: bool) -> Any:
        self.asked += 1
        if np.abs(u).max() > self.far_mm:
            raise InvertedElement
        energy = float((STIFF * u**2 / 2 + self.hard * u**4 / 4 - self.force * u).sum())
        tangent = (STIFF + 3 * self.hard * u**2)[FREE] if stiffness else None
        return SimpleNamespace(energy=energy, forces=STIFF * u + self.hard * u**3 - self.force, stiffness=tangent)


class Diagonal:
    """A solver for them."""

    def __init__(self, first: Array | None = None) -> None:
        self.diagonal, self.factorised = first, 0

    def factorise(self, diagonal: Array) -> None:
        self.diagonal, self.factorised = diagonal, self.factorised + 1

    def solve(self, right: Array) -> Array:
        assert self.diagonal is not None
        return right / self.diagonal


def found(springs: Any, solver: Any, tolerance_mm: float = 1e-9) -> newton.Solution:
    load: Any = None
    return solve(springs, solver, np.zeros(SHAPE), load, tolerance_mm)


def settled(springs: Any, solver: Any, accuracy: float = 1e-8) -> Array:
    load: Any = None
    return quasi_newton.settle(springs, solver, np.zeros(SHAPE), load, accuracy)


@pytest.mark.parametrize("hard", [0.0, 0.3, 5.0])
def test_newton_finds_the_equilibrium_and_counts(hard: float) -> None:
    solver = Diagonal()
    solution = found(Springs(hard), solver)
    np.testing.assert_allclose(solution.displacement, ROOTS, atol=1e-9)
    assert solution.iterations == solver.factorised and solution.correction_mm < 1e-9
    if hard == 0:
        assert solution.iterations == 2  # the second finds nothing left


def test_newton_waits_for_a_step_that_is_taken_whole() -> None:
    """Each step is cut to half until the fifth: a small correction that is cut is no end."""
    steps: list[float] = []

    def reach(displacement: Array, correction: Array) -> float:
        steps.append(float(np.abs(correction).max()))
        return 0.5 if len(steps) < 5 else 1.0

    solution = found(Springs(0.0, reach=reach), Diagonal(), tolerance_mm=10.0)
    assert solution.iterations == 5
    assert steps == pytest.approx([3.0, 1.5, 0.75, 0.375, 0.1875])
    np.testing.assert_allclose(solution.displacement, ROOTS, atol=1e-12)


def test_newton_gives_up_after_fifteen_iterations_and_on_what_is_no_number() -> None:
    solver = Diagonal()
    with pytest.raises(NoConvergence):
        found(Springs(0.0, reach=lambda *_: 0.5), solver, tolerance_mm=1e-300)
    assert solver.factorised == 15
    broken: Any = SimpleNamespace(factorise=lambda _: None, solve=lambda right: np.nan * right)
    with pytest.raises(NoConvergence):
        found(Springs(0.0), broken)
    with pytest.raises(NoConvergence):
        found(Springs(0.0, far_mm=-1.0), Diagonal())  # inverted at the start


def line(energies: dict[float, float | None], descent: float, longest: float = 1.0) -> float:
    """The step along a line on which these are the energies, None where an element is inverted; 0 at its start."""

    def balance(u: Array, load: Any, *, stiffness: bool) -> Any:
        assert not stiffness
        energy = energies[float(u[0, 0]) - 7.0]
        if energy is None:
            raise InvertedElement
        return SimpleNamespace(energy=energy)

    equilibrium: Any = SimpleNamespace(balance=balance)
    here: Any = SimpleNamespace(energy=0.0)
    load: Any = None
    return step_length(equilibrium, np.full((1, 3), 7.0), np.ones((1, 3)), load, here, descent, longest)


def test_a_step_is_halved_until_elements_are_valid_and_the_energy_has_fallen_enough() -> None:
    assert line({1.0: -1e-3}, descent=-10.0) == 1.0  # exactly 1e-4 of what the slope promises
    assert line({1.0: -0.99e-3, 0.5: -0.5e-3}, descent=-10.0) == 0.5
    assert line({1.0: None, 0.5: 3.0, 0.25: -1.0}, descent=-10.0) == 0.25
    assert line({1.0: 5.0}, descent=np.inf) == 1.0  # any energy will do
    assert line({0.75: 1.0, 0.375: -1.0}, descent=-1.0, longest=0.75) == 0.375
    halves: dict[float, float | None] = {2.0**-k: 1.0 for k in range(20)}
    with pytest.raises(NoConvergence):
        line(halves, descent=-1.0)
    assert line({**halves, 2.0**-9: -1.0}, descent=-1.0) == 2.0**-9  # above a thousandth
    with pytest.raises(NoConvergence):
        line({**halves, 2.0**-10: -1.0}, descent=-1.0)


def test_direction_is_that_of_the_updated_inverse() -> None:
    """H ← (I − s yᵀ/sᵀy) H (I − y sᵀ/sᵀy) + s sᵀ/sᵀy, update after update."""
    rng = np.random.default_rng(0)
    diagonal, forces = rng.uniform(1, 3, 6), rng.normal(size=6)
    inverse, updates = np.diag(1 / diagonal), []
    for _ in range(3):
        s, y = rng.normal(size=(2, 6))
        rho = 1 / float(s @ y)
        inverse = (np.eye(6) - rho * np.outer(s, y)) @ inverse @ (np.eye(6) - rho * np.outer(y, s))
        inverse += rho * np.outer(s, s)
        updates.append((s, y, rho))
    solver: Any = Diagonal(diagonal)
    np.testing.assert_allclose(quasi_newton._direction(solver, updates, forces), inverse @ forces, rtol=1e-10)


@pytest.mark.parametrize("hard", [0.0, 0.02, 0.3])
def test_bfgs_settles_in_the_equilibrium(hard: float) -> None:
    """It ends where a step promises 1e-10 of the energy released, some 30 N mm: 5e-5 mm of a spring of 1 N/mm."""
    solver = Diagonal(STIFF[FREE])
    np.testing.assert_allclose(settled(Springs(hard), solver), ROOTS, atol=5e-5)
    assert solver.factorised <= (0 if hard == 0 else 4)


def test_bfgs_goes_on_behind_what_inverts_an_element_and_gives_up_where_it_must() -> None:
    """The first way would go to the root of the softer springs, twice as far as elements are valid."""
    springs = Springs(0.02, far_mm=3.5)
    solver = Diagonal(0.4 * STIFF[FREE])
    np.testing.assert_allclose(settled(springs, solver), ROOTS, atol=5e-5)
    with pytest.raises(NoConvergence):
        settled(Springs(0.0, far_mm=-1.0), Diagonal(STIFF[FREE]))
    with pytest.raises(NoConvergence):
        settled(Springs(0.3, reach=lambda *_: 1e-3), Diagonal(STIFF[FREE]))


class Soft:
    """One spring that gives in, atan u = atan 1.5, whose linearisation shoots far beyond from afar."""

    free = np.ones((1, 1), dtype=bool)

    def __init__(self) -> None:
        self.visited: list[tuple[float, float]] = []  # places whose stiffness was asked for, and their energies

    def free_step(self, displacement: Array, correction: Array) -> float:
        return 1.0

    def balance(self, u: Array, load: Any, *, stiffness: bool) -> Any:
        at = float(u[0, 0])
        energy = at * np.arctan(at) - np.log1p(at**2) / 2 - np.arctan(1.5) * at
        if stiffness:
            self.visited.append((at, energy))
        tangent = np.array([1 / (1 + at**2)]) if stiffness else None
        return SimpleNamespace(energy=energy, forces=np.arctan(u) - np.arctan(1.5), stiffness=tangent)


def test_newton_takes_the_first_step_whole_and_lowers_the_energy_by_every_other() -> None:
    spring: Any = Soft()
    solver: Any = Diagonal()
    load: Any = None
    solution = solve(spring, solver, np.full((1, 1), -5.0), load, 1e-9)
    assert solution.displacement[0, 0] == pytest.approx(1.5, abs=1e-12)
    places, energies = zip(*spring.visited, strict=True)
    assert places[1] == pytest.approx(-5 + 26 * (np.arctan(5) + np.arctan(1.5)))  # the whole way, to some 56
    assert energies[1] > energies[0] and (np.diff(energies[1:]) <= 1e-15).all()
    whole = places[1] - (1 + places[1] ** 2) * (np.arctan(places[1]) - np.arctan(1.5))
    assert whole < -1000 < -100 < places[2]  # which the second step does not go


def cut(energies: dict[float, float | None], slope: float = -1.0, start: float = 0.0, reach: float = 1.0) -> float:
    """How much of a way is taken on which these are the energies, from that at its start."""

    def balance(u: Array, load: Any, *, stiffness: bool) -> Any:
        energy = next(value for key, value in energies.items() if key == pytest.approx(float(u[0, 0])))
        if energy is None:
            raise InvertedElement
        return SimpleNamespace(energy=start + energy)

    equilibrium: Any = SimpleNamespace(balance=balance, free_step=lambda *_: reach)
    here: Any = SimpleNamespace(energy=start)
    load: Any = None
    length, there = quasi_newton._step(equilibrium, np.zeros((1, 3)), np.ones((1, 3)), load, here, slope)
    assert (there is here) == (length == 0)
    return length


def test_bfgs_cuts_a_step_to_the_lowest_point_of_a_parabola() -> None:
    assert cut({1.0: -1.1e-4}) == 1.0 and cut({1.0: -0.9e-4, 0.5: -1.0}) == pytest.approx(0.5, rel=1e-3)
    assert cut({1.0: 1.5, 0.2: -0.1}) == pytest.approx(0.2)  # −l + 2.5 l² is lowest at 0.2
    assert cut({1.0: 100.0, 0.1: -0.1}) == pytest.approx(0.1)  # at least a tenth
    assert cut({0.4: 0.6, 0.08: -0.01}, reach=0.4) == pytest.approx(0.08)  # −l + 6.25 l² at 0.08
    assert cut({1.0: 1.0, 0.4: -0.8}, slope=-4.0) == pytest.approx(0.4)  # −4 l + 5 l² at 0.4
    assert cut({1.0: None, 0.5: None, 0.25: -0.1}) == pytest.approx(0.25)
    assert cut({}, slope=0.0) == 0 and cut({}, slope=1.0) == 0
    assert cut({10.0**-k: 100.0 for k in range(6)}) == 0


def test_bfgs_sees_an_energy_no_better_than_its_round_off() -> None:
    """Of 1e8 N mm the last 1e-5: a fall by 1e-4 that is missed by less is one, and by more is none."""
    assert cut({1.0: -0.95e-4}, start=1e8) == 1.0
    assert cut({1.0: -0.85e-4, 0.5: -1.0}, start=1e8) < 1


def descended(accuracy: float, steps: int) -> tuple[Any, bool]:
    """One spring of 1 N/mm from 100 mm to 104 mm, with a solver that takes it for 1.25 N/mm; another is at rest."""
    rest = np.array([[104.0, 7.0]])

    def balance(u: Array, load: Any, *, stiffness: bool) -> Any:
        return SimpleNamespace(energy=float(((u - rest) ** 2).sum() / 2), forces=u - rest)

    spring: Any = SimpleNamespace(free=np.ones((1, 2), dtype=bool), balance=balance, free_step=lambda *_: 1.0)
    start = np.array([[100.0, 7.0]])
    solver: Any = Diagonal(np.full(2, 1.25))
    load: Any = None
    end, near = quasi_newton._descend(spring, solver, start, 8.0, start, load, accuracy, steps)
    return float(end[0, 0]), near


def test_bfgs_learns_the_stiffness_from_its_first_step_and_ends_by_its_last() -> None:
    """3.2 mm of 4 mm, and the rest exactly, which is a fifth of the way from the start."""
    assert descended(0.0, 1) == (pytest.approx(103.2), False)
    assert descended(0.15, 2) == (pytest.approx(104.0, abs=1e-12), False)
    assert descended(0.25, 2) == (pytest.approx(104.0, abs=1e-12), True)
    assert descended(0.0, 3) == (pytest.approx(104.0, abs=1e-12), True)  # nothing is left to gain


def test_the_energy_has_to_fall_by_the_slope_along_the_correction(monkeypatch: pytest.MonkeyPatch) -> None:
    """The slope at its start is −cᵀ K c, with c the correction and K the stiffness; the first step may rise."""
    slopes: list[tuple[float, float]] = []
    inner = newton.step_length

    def watched(equilibrium: Any, displacement: Array, correction: Array, *others: Any) -> float:
        stiff = (STIFF + 15 * displacement**2) * correction**2
        slopes.append((others[2], -float(stiff[FREE].sum())))
        return inner(equilibrium, displacement, correction, *others)

    monkeypatch.setattr(newton, "step_length", watched)
    found(Springs(5.0), Diagonal())
    assert slopes[0][0] == np.inf and len(slopes) > 3
    assert [told for told, _ in slopes[1:]] == pytest.approx([by_hand for _, by_hand in slopes[1:]])
