"""Hermite interpolation and the adaptive load path, on branches known in closed form."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from pgdl_lab.mechanics.newton import NoConvergence, Solution
from pgdl_lab.mechanics.path import SMALLEST_INTERVAL, Branch, PathEnded, follow, refine

Array = NDArray[np.float64]


def test_hermite_is_exact_for_its_degree() -> None:
    polynomial = np.polynomial.Polynomial([1, -2, 3, 0.5, -1, 0.25, 2, -0.7])  # degree 7 = 2 · 4 − 1
    nodes = [0.0, 0.7, 1.1, 2.0]
    values, slopes = ([np.array([[f(x)]]) for x in nodes] for f in (polynomial, polynomial.deriv()))
    branch = Branch(nodes, values, slopes)
    for at in (-0.3, 0.35, 1.5, 2.6):
        assert branch.at(at)[0, 0] == pytest.approx(polynomial(at), rel=1e-10)


@dataclass
class ClosedForm:
    """Equilibria on an arc of radius 50 mm; Newton's method fails where the guess is worse than `reach_mm`.

    From `kink` on they leave it by `size` (x − kink)^`order`: their derivative of that order jumps.
    """

    reach_mm: float = 10.0
    ends: float = np.inf
    kink: float = np.inf
    size: float = 0.1
    order: int = 1
    solved: list[float] = field(default_factory=list)
    tried: int = 0

    def exact(self, x: float) -> Array:
        arc = 50 * np.array([[np.sin(x / 20), 0.0, np.cos(x / 20)]])
        return arc + self.size * max(0.0, x - self.kink) ** self.order

    def solve(self, start: Array, parameter: float) -> Solution:
        self.tried += 1
        if parameter > self.ends or np.abs(start - self.exact(parameter)).max() > self.reach_mm:
            raise NoConvergence
        self.solved.append(parameter)
        return Solution(self.exact(parameter), 3, 0.0)

    def slope(self, solution: Solution, parameter: float) -> Array:
        return (self.exact(parameter + 1e-6) - self.exact(parameter - 1e-6)) / 2e-6


WANTED = np.linspace(0.1, 50, 500)


def worst_error(leg: ClosedForm, branch: Branch) -> float:
    return max(float(np.abs(branch.at(x) - leg.exact(x)).max()) for x in WANTED)


def test_smooth_branch_needs_few_equilibria() -> None:
    leg, told = ClosedForm(), []
    branch = follow(leg, leg.exact(0), 50.0, 1.0, told.append)
    assert branch.parameters[0] == 0 and branch.parameters[-1] == 50
    assert branch.parameters == sorted(branch.parameters) and told[-1] == 50
    estimate = refine(leg, branch, WANTED, 1e-5)
    assert len(branch.parameters) < 20
    assert branch.iterations == 3 * len(branch.parameters)
    assert worst_error(leg, branch) <= 1e-5
    assert estimate <= 1e-5


def test_step_is_cut_where_newton_fails() -> None:
    leg, told = ClosedForm(reach_mm=0.05), []
    branch = follow(leg, leg.exact(0), 50.0, 25.0, told.append)
    assert branch.parameters[-1] == 50
    assert branch.parameters[1] < 25
    assert told == branch.parameters[1:]  # nothing that was not reached


def test_what_lies_before_a_kink_does_not_mislead_the_steps_after_it() -> None:
    """Guesses from few equilibria take over: from four throughout it takes 380 solves, 60 more."""
    random, tried = np.random.default_rng(0), 0
    for _ in range(20):
        kink, size = random.uniform(5, 45), 10 ** random.uniform(-1, 1) * random.choice([-1, 1])
        leg = ClosedForm(kink=kink, size=size, reach_mm=1.0)
        branch = follow(leg, leg.exact(0), 50.0, 2.0, lambda _: None)
        assert branch.parameters[-1] == 50
        tried += leg.tried
    assert tried < 340


def test_equilibria_gather_at_a_kink() -> None:
    leg = ClosedForm(kink=31.4)
    branch = follow(leg, leg.exact(0), 50.0, 2.0, lambda _: None)
    before = len(branch.parameters)
    estimate = refine(leg, branch, WANTED, 1e-4)
    added = len(branch.parameters) - before
    assert added > 5
    assert np.median(np.abs(np.array(leg.solved[-added:]) - 31.4)) < 2
    assert worst_error(leg, branch) < 1e-3
    assert estimate < 1e-3  # the kink itself lies in an interval of the smallest step


def test_equilibria_are_added_only_where_they_are_wanted() -> None:
    leg, wanted = ClosedForm(kink=31.4), np.array([10.0, 31.5, 50.0])
    branch = follow(leg, leg.exact(0), 50.0, 2.0, lambda _: None)
    before = set(branch.parameters)
    estimate = refine(leg, branch, wanted, 1e-9)
    assert set(branch.parameters) - before == {10.0, 31.5} - before
    assert estimate == 0.0


@pytest.mark.parametrize("order", [1, 2, 3])
def test_bound_holds_across_any_kink(order: int) -> None:
    """Kinks like those where surfaces meet: whatever lies between the equilibria is off by the estimate at most."""
    random, tolerance = np.random.default_rng(order), 1e-5
    for _ in range(10):
        kink, size = random.uniform(0, 50), 10 ** random.uniform(-3, 0) * random.choice([-1, 1])
        leg = ClosedForm(kink=kink, size=size, order=order)
        branch = follow(leg, leg.exact(0), 50.0, 2.0, lambda _: None)
        estimate = refine(leg, branch, WANTED, tolerance)
        assert estimate <= tolerance
        assert worst_error(leg, branch) <= tolerance, (kink, size)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("interval", [0, 1])
def test_one_kink_is_off_by_twice_and_a_half_its_estimate_at_most(order: int, interval: int) -> None:
    random = np.random.default_rng(order)
    for _ in range(100):
        branch = Branch(np.cumsum([0.0, *2 ** random.uniform(-1.5, 1.5, 3)]).tolist())
        kink = random.uniform(branch.parameters[0], branch.parameters[-1])
        beyond = np.maximum(np.array(branch.parameters) - kink, 0)
        branch.displacements = list(beyond**order)
        branch.slopes = list(order * beyond ** (order - 1) * (beyond > 0))
        start, stop = branch.parameters[interval : interval + 2]
        error = max(abs(branch.at(x) - max(0.0, x - kink) ** order) for x in np.linspace(start, stop, 41))
        assert error <= 2.5 * branch.doubt(start, stop), (branch.parameters, kink)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_few_equilibria_are_in_doubt_too(count: int) -> None:
    leg, branch = ClosedForm(reach_mm=np.inf), Branch()
    for x in np.linspace(0, 50, count):
        branch.add(leg, leg.exact(0), float(x))
    start, stop = branch.parameters[:2]
    between = np.linspace(start, stop, 21)[1:-1]
    error = max(float(np.abs(branch.at(x) - leg.exact(x)).max()) for x in between)
    assert 1e-4 < error <= branch.doubt(start, stop)


def test_doubt_counts_where_no_equilibrium_can_be_added() -> None:
    """Beside an equilibrium too close to have one of its own, and where Newton's method fails."""
    leg = ClosedForm()
    branch = follow(leg, leg.exact(0), 50.0, 2.0, lambda _: None)
    known, beside = len(branch.parameters), branch.parameters[3] + 0.5 * SMALLEST_INTERVAL * 50
    leg.reach_mm = 0.0
    alone, along = (refine(leg, branch, np.array(wanted), 1e-9) for wanted in ([beside], [beside, 31.0]))
    assert len(branch.parameters) == known
    assert 0 < np.abs(branch.at(beside) - leg.exact(beside)).max() <= alone < 1e-9
    assert along > np.abs(branch.at(31.0) - leg.exact(31.0)).max() > 1e-9


def test_end_of_the_branch_keeps_what_was_found() -> None:
    leg = ClosedForm(ends=33.3)
    with pytest.raises(PathEnded) as caught:
        follow(leg, leg.exact(0), 50.0, 2.0, lambda _: None)
    assert caught.value.branch.parameters[-1] == pytest.approx(33.3, abs=0.02)
    assert caught.value.branch.limit() is None  # it ends, but does not turn back


class Fold(ClosedForm):
    """Equilibria p = 40 − (q − 2)² / 0.1 that turn back at 40."""

    def exact(self, x: float) -> Array:
        return np.array([[2 - np.sqrt(0.1 * max(0.0, 40 - x)), 0.0, 0.0]])

    def slope(self, solution: Solution, parameter: float) -> Array:
        return np.array([[np.sqrt(0.1) / 2 / np.sqrt(40 - parameter), 0.0, 0.0]])


def test_a_limit_point_is_told_from_another_end() -> None:
    leg = Fold(ends=np.nextafter(40.0, 0.0))
    with pytest.raises(PathEnded) as caught:
        follow(leg, leg.exact(0), 50.0, 2.0, lambda _: None)
    assert caught.value.branch.limit() == pytest.approx(40, rel=1e-6)


@pytest.mark.parametrize(("last", "limit"), [(39.965, 40.0), (39.95, None)])
def test_a_limit_point_is_told_from_the_last_two_equilibria(last: float, limit: float | None) -> None:
    """If it is within a thousandth of the path."""
    leg, branch = Fold(reach_mm=np.inf), Branch()
    for parameter in (0.0, 30.0, last):
        branch.add(leg, leg.exact(0), parameter)
    assert branch.limit() == (None if limit is None else pytest.approx(limit))
    alone = Branch()
    alone.add(leg, leg.exact(0), 39.99)
    assert alone.limit() is None


def test_nearest_equilibria() -> None:
    """As many on either side, or those next to an end; all, where there are no more."""
    branch = Branch([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    for parameter, near in ((-1.0, [0, 1, 2, 3]), (0.5, [0, 1, 2, 3]), (2.5, [1, 2, 3, 4]), (4.5, [2, 3, 4, 5])):
        assert list(branch.near(parameter)) == near
    assert list(branch.near(4.5, 2)) == [4, 5] and list(branch.near(6.0, 3)) == [3, 4, 5]
    for count in (1, 2, 3, 4):
        for parameter in (-1.0, 0.5, 2.5, 9.0):
            assert list(Branch(branch.parameters[:count]).near(parameter)) == list(range(count))
