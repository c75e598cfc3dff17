"""The separable regression against dense algebra, and on fields that are drawn from its own prior."""

import numpy as np
import pytest
import scipy.linalg
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.learning import clock
from pgdl_lab.learning.clock import Clock
from pgdl_lab.learning.compression import compressed
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.pod import decompose, known
from pgdl_lab.learning.separable import Posterior, Prior, SeparableRegression
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.triangulation import Triangulation
from tests.learning.test_triangulation import rectangle

RANGE_KPA = np.array([0.0, 50.0])
BASIS = Basis.of([RANGE_KPA], 2)
PRIOR = Prior(np.array([[1.0, 0.3, 0.0], [0.3, 0.5, 0.0], [0.0, 0.0, 0.01]]), 0.02)


def drawn(body: Triangulation, count: int, seed: int) -> tuple[SeparableRegression, np.ndarray]:
    """Samples of a field that is drawn from `PRIOR`, zero on the left edge, and the field's coefficients (N, 3, 2)."""
    rng = np.random.default_rng(seed)
    nodes = len(body.points_mm)
    clamp = np.flatnonzero(body.points_mm[:, 0] == 0)
    free = np.setdiff1d(np.arange(nodes), clamp)
    kinks = body.kinks[:, free].toarray()
    root = np.linalg.cholesky(np.linalg.inv(kinks.T @ kinks + 1e-6 * np.eye(len(free))))
    field = np.zeros((nodes, 3, 2))
    field[free] = np.einsum("nm,mkc,lk->nlc", root, rng.normal(size=(len(free), 3, 2)), PRIOR.amplitudes)
    node, kpa = rng.integers(nodes, size=count), rng.uniform(0, 50, count)
    values = np.einsum("nk,nkc->nc", BASIS(kpa), field[node])
    values += PRIOR.noise_mm * rng.normal(size=values.shape)
    return SeparableRegression(body, clamp, Samples(body.points_mm[node], Cases.path(kpa), values), BASIS), field


def coefficients(posterior: Posterior) -> np.ndarray:
    return np.einsum("lk,nkc->nlc", posterior.prior.amplitudes, posterior.modes)


def dense(regression: SeparableRegression) -> tuple[np.ndarray, np.ndarray]:
    """Mean (3 M, 2) and covariance (3 M, 3 M) of the coefficients of the M free nodes, by the textbook formula."""
    hats, kinks = regression.hats.toarray(), regression.kinks.toarray()
    design = np.einsum("nk,nm->nmk", regression.polynomials, hats).reshape(len(hats), -1)
    precision = np.kron(kinks.T @ kinks, np.linalg.inv(PRIOR.covariance)) + design.T @ design / PRIOR.noise_mm**2
    covariance = scipy.linalg.inv(precision)
    return covariance @ design.T @ regression.samples.displacements_mm / PRIOR.noise_mm**2, covariance


def test_mean_and_draws_are_those_of_the_textbook_formula() -> None:
    regression, _ = drawn(rectangle(3), 60, seed=0)
    count = 4000
    posterior = regression.posterior(PRIOR, count, np.random.default_rng(1))
    mean, covariance = dense(regression)
    free = regression.free
    assert coefficients(posterior)[free].reshape(mean.shape) == pytest.approx(mean, abs=1e-6)
    draws = np.einsum("lk,nks->nls", PRIOR.amplitudes, posterior.draws)[free].reshape(len(mean), count)
    ratio = (draws**2).mean(axis=1) / np.diag(covariance)
    # each is chi-squared with 4000 degrees of freedom by 4000: deviation sqrt(2 / 4000) = 0.022; five of them
    assert np.abs(ratio - 1).max() < 0.11


def test_left_out_samples_do_not_count() -> None:
    body = rectangle(4)
    regression, _ = drawn(body, 200, seed=0)
    kept = np.arange(200) < 120
    samples = regression.samples
    fewer = samples.at(kept)
    clamp = np.setdiff1d(np.arange(len(body.points_mm)), regression.free)
    alone = SeparableRegression(body, clamp, fewer, BASIS).posterior(PRIOR, 0, np.random.default_rng(0))
    among = regression.posterior(PRIOR, 0, np.random.default_rng(0), kept)
    assert among.modes == pytest.approx(alone.modes, abs=1e-8)


def test_clamp_is_held_exactly() -> None:
    regression, _ = drawn(rectangle(4), 100, seed=0)
    posterior = regression.posterior(PRIOR, 2, np.random.default_rng(0))
    held = np.setdiff1d(np.arange(regression.nodes), regression.free)
    assert len(held) == 5 and not posterior.modes[held].any() and not posterior.draws[held].any()


def test_prior_and_noise_are_learnt_from_the_data() -> None:
    regression, _ = drawn(rectangle(12), 3000, seed=0)
    prior, rng = regression.first_prior(), np.random.default_rng(1)
    for _ in range(8):
        prior = regression.learnt(regression.posterior(prior, 16, rng))
    # 3000 samples less the degrees of freedom that the field takes up leave the noise known to about 2 %
    assert prior.noise_mm == pytest.approx(PRIOR.noise_mm, rel=0.1)
    # 2 · 156 kinked nodes: the variance of each order is known to sqrt(2 / 312) = 8 % at best
    assert np.diag(prior.covariance)[:2] == pytest.approx(np.diag(PRIOR.covariance)[:2], rel=0.4)
    assert prior.covariance[0, 1] > 0.1


def test_bars_cover_what_they_promise() -> None:
    regression, field = drawn(rectangle(12), 1500, seed=3)
    rng = np.random.default_rng(1)
    posterior = regression.posterior(PRIOR, 64, rng)
    learnt = decompose(regression, PRIOR, 64, rng)
    kpa, deviations = learnt["bar_kpa"].numpy(), learnt["bar_deviations"].numpy()
    assert kpa[0] == 0 and kpa[1] == regression.samples.pressures_kpa.max() and kpa[2] > kpa[1]
    # the data are of the model's own making: nearly 1.96 deviations, known from 150 samples
    assert deviations[:2] == pytest.approx([1.96, 1.96], rel=0.25) and deviations[2] >= deviations[1]
    polynomials = BASIS(np.linspace(0, 50, 11))
    error = np.einsum("pk,nkc->pnc", polynomials, coefficients(posterior) - field)[:, regression.free]
    spread = np.einsum("pk,kl,nls->pns", polynomials, PRIOR.amplitudes, posterior.draws)[:, regression.free]
    covered = np.abs(error) < 1.96 * np.sqrt((spread**2).mean(axis=2))[..., None]
    assert 0.9 < covered.mean() < 0.99


def test_polynomials_beyond_the_trained_pressures_go_on() -> None:
    body = rectangle(6)
    rng = np.random.default_rng(0)
    node, kpa = rng.integers(len(body.points_mm), size=600), rng.uniform(0, 44, 600)

    def truth(points: np.ndarray, kpa: np.ndarray) -> np.ndarray:
        x, share = points[:, 0], kpa / 50
        return np.stack([x**2 * share - x * share**3, x * points[:, 1] * share**2], axis=1)

    samples = Samples(body.points_mm[node], Cases.path(kpa), truth(body.points_mm[node], kpa))
    trained = np.array([0.0, 44.0])
    regression = SeparableRegression(body, np.flatnonzero(body.points_mm[:, 0] == 0), samples, Basis.of([trained], 5))
    posterior = regression.posterior(regression.first_prior(), 0, np.random.default_rng(0))
    top = np.einsum("k,nkc->nc", Basis.of([trained], 5)(np.array([50.0]))[0], coefficients(posterior))
    assert np.abs(top - truth(body.points_mm, np.full(len(top), 50.0))).max() < 1e-2


def test_what_is_assumed_at_first_scales_with_the_field_and_the_body() -> None:
    body, (regression, _) = rectangle(4), drawn(rectangle(4), 50, seed=0)
    clamp = np.setdiff1d(np.arange(regression.nodes), regression.free)
    larger = Triangulation(3 * body.points_mm, body.simplices)
    samples = regression.samples
    samples = Samples(3 * samples.points_mm, samples.cases, 5 * samples.displacements_mm)
    one, other = regression.first_prior(), SeparableRegression(larger, clamp, samples, BASIS).first_prior()
    assert other.covariance == pytest.approx((5 / 3) ** 2 * one.covariance)
    assert other.noise_mm == pytest.approx(5 * one.noise_mm)
    # each order is a fifth of the one before; the first is the root mean square by the diagonal
    size_mm = np.sqrt((regression.samples.displacements_mm**2).mean())
    assert np.sqrt(np.diag(one.covariance)) == pytest.approx(size_mm / np.hypot(2, 1) * np.array([1, 0.2, 0.04]))


def test_a_rough_field_lets_expect_kinks_where_it_has_them() -> None:
    body = rectangle(6)
    regression, _ = drawn(body, 50, seed=0)
    clamp = np.setdiff1d(np.arange(regression.nodes), regression.free)
    x, z = body.points_mm.T
    rough = np.stack([np.abs(x - 1), 2 * np.abs(x - 1) + x - z], axis=1)  # folded along x = 1, flat elsewhere
    eased = SeparableRegression(body, clamp, regression.samples, BASIS, rough)
    norms = [np.sqrt(np.asarray(each.kinks.multiply(each.kinks).sum(axis=1)).ravel()) for each in (regression, eased)]
    there = np.linalg.norm(body.kinks @ rough, axis=1)
    ratio = norms[0] / norms[1]  # of the size that a kink is expected to have
    assert ((there > 1e-9).sum() >= 6) and ratio[there < 1e-9] == pytest.approx(1)
    assert ratio == pytest.approx(np.sqrt(1 + 16 * there**2 / (there**2).mean()))
    assert ratio.max() > 4


def test_values_at_samples_are_those_of_the_field() -> None:
    regression, _ = drawn(rectangle(4), 40, seed=0)
    posterior = regression.posterior(PRIOR, 3, np.random.default_rng(0))
    mean, deviation = regression.at_samples(posterior)
    points, kpa = regression.samples.points_mm, regression.samples.pressures_kpa
    for i in range(40):
        node = np.flatnonzero((rectangle(4).points_mm == points[i]).all(axis=1))[0]
        orders = np.cos(np.arange(3) * np.arccos(kpa[i] / 25 - 1)) @ PRIOR.amplitudes
        assert mean[i] == pytest.approx(orders @ posterior.modes[node])
        assert deviation[i] == pytest.approx(orders @ posterior.draws[node])


def test_spreads_are_square_roots_of_the_covariance_of_the_draws() -> None:
    regression, _ = drawn(rectangle(4), 40, seed=0)
    posterior = regression.posterior(PRIOR, 30, np.random.default_rng(0))
    state = known(posterior)
    spread = state["spread"].numpy().astype(float)
    draws_mm = np.einsum("dk,nks->nds", PRIOR.amplitudes, posterior.draws)
    for root, draws in zip(spread, draws_mm, strict=True):
        assert root @ root.T == pytest.approx(draws @ draws.T / 30, rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("bars", [None, [2.5, 9.0], [0.196, 2.0]])
@pytest.mark.parametrize(("noise_mm", "deviation_mm"), [(1.0, 0.03), (0.003, 1.0)])
def test_as_many_modes_are_kept_as_a_singular_value_decomposition_needs(
    bars: list[float] | None, noise_mm: float, deviation_mm: float
) -> None:
    """Eckart and Young: of as many modes no others leave less. Left are a tenth of the deviation, or the noise."""
    rng, kpa = np.random.default_rng(0), np.linspace(0, 1.25 * 50, 400)
    sizes = np.diag([10.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5])
    modes, spread = rng.standard_normal((80, 6, 2)), np.zeros((80, 6, 6))
    spread[:, 0, 0] = deviation_mm  # the same at all pressures
    arrays = {"modes": modes, "amplitudes": sizes, "spread": spread, "noise_mm": np.array(noise_mm)}
    state = {name: torch.from_numpy(array) for name, array in {**arrays, "range_kpa": RANGE_KPA}.items()}
    few = compressed(state if bars is None else {**state, "bar_deviations": torch.tensor(bars)})
    polynomials = Basis.of([RANGE_KPA], 5)(kpa)
    field = np.einsum("pd,dk,nkc->pnc", polynomials, sizes, modes).reshape(400, -1)
    near = np.einsum("pd,dk,nkc->pnc", polynomials, few["amplitudes"].numpy(), few["modes"].numpy()).reshape(400, -1)
    singular = np.linalg.svd(field, compute_uv=False)
    rest_mm = np.sqrt(np.cumsum(singular[::-1] ** 2)[::-1] / field.size)
    most_mm = 0.003 * (0.1 if bars == [0.196, 2.0] else 1.0)
    count = few["modes"].shape[1]
    assert count == (rest_mm > most_mm).sum() and 1 < count < 6
    assert np.sqrt(((near - field) ** 2).mean()) == pytest.approx(rest_mm[count], rel=0.1)
    assert (few["modes"].numpy() ** 2).mean(axis=(0, 2)) == pytest.approx(1)


def test_points_that_never_move_are_refused() -> None:
    body = rectangle(3)
    samples = Samples(body.points_mm, Cases.path(np.full(len(body.points_mm), 10.0)), np.zeros_like(body.points_mm))
    with pytest.raises(InputError, match="every training point is 0 mm"):
        SeparableRegression(body, np.array([0]), samples, BASIS).first_prior()


def test_polynomials_span_the_range_of_pressures_wherever_it_begins() -> None:
    """T₁ is −1 at its lower end, 0 in its middle and 1 at its upper end, and T₂ = 2 T₁² − 1."""
    found = Basis.of([np.array([10.0, 30.0])], 2)(np.array([10.0, 20.0, 30.0, 40.0]))
    np.testing.assert_allclose(found, [[1, -1, 1], [1, 0, -1], [1, 1, 1], [1, 2, 7]])


def test_as_many_fits_are_allowed_as_take_no_longer_than_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits of 3 s, of which three end within 10 s and a fourth does not."""
    at = [100.0]
    monkeypatch.setattr(clock, "now", lambda: at[0])
    whole, _ = drawn(rectangle(3), 30, seed=0)
    held = np.setdiff1d(np.arange(whole.nodes), whole.free)
    given = Clock(17.0, spent_s=4.0)
    regression = SeparableRegression(rectangle(3), held, whole.samples, BASIS, clock=given)
    assert given.seconds == 4.0 and given.left_s == 13.0 and regression.allows(10**6)  # nothing is known yet
    solve = regression._solver.solve

    def slow(right: np.ndarray) -> np.ndarray:
        at[0] += 3.0
        return solve(right)

    monkeypatch.setattr(regression._solver, "solve", slow)
    regression.posterior(PRIOR, 0, np.random.default_rng(0))
    assert given.seconds == 7.0 and given.left_s == 10.0
    assert regression.allows(3) and not regression.allows(4)
    at[0] += 1.0
    assert regression.allows(3)  # to the second
    at[0] += 9.0
    assert given.left_s == 0.0 and not regression.allows(0)
    at[0] += 1.0
    assert given.left_s == 0.0 and given.seconds == 18.0


def test_noise_is_what_is_left_by_the_degrees_of_freedom_that_a_fit_takes() -> None:
    """150 samples of 126 coefficients: the residual alone is far less than the noise."""
    ratios, shares = [], []
    for seed in range(6):
        regression, _ = drawn(rectangle(6), 150, seed)
        posterior = regression.posterior(PRIOR, 200, np.random.default_rng(seed))
        mean, _ = regression.at_samples(posterior)
        shares.append(np.sqrt(((mean - regression.samples.displacements_mm) ** 2).mean()) / PRIOR.noise_mm)
        ratios.append(regression.learnt(posterior).noise_mm / PRIOR.noise_mm)
    assert np.mean(shares) < 0.8
    assert np.mean(ratios) == pytest.approx(1, abs=0.1)


def test_noise_has_a_floor_by_the_size_of_the_data() -> None:
    """Data of 0.3 mm that a field of few nodes meets exactly."""
    body = rectangle(2)
    clamp = np.flatnonzero(body.points_mm[:, 0] == 0)
    free = np.setdiff1d(np.arange(len(body.points_mm)), clamp)
    samples = Samples(body.points_mm[free], Cases.path(np.full(len(free), 25.0)), np.full((len(free), 2), 0.3))
    regression = SeparableRegression(body, clamp, samples, BASIS)
    exact = regression.posterior(Prior(PRIOR.covariance, 1e-8), 4, np.random.default_rng(0))
    assert regression.learnt(exact).noise_mm == pytest.approx(1e-6 * 0.3)


def test_one_mode_is_kept_of_a_field_below_the_noise() -> None:
    modes = np.random.default_rng(0).standard_normal((80, 3, 2))
    arrays = {"modes": modes, "amplitudes": 1e-9 * np.eye(3), "spread": np.ones((80, 3, 3)), "noise_mm": np.array(1.0)}
    state = {name: torch.from_numpy(array) for name, array in {**arrays, "range_kpa": RANGE_KPA}.items()}
    assert compressed(state)["modes"].shape == (80, 1, 2)


@pytest.mark.parametrize(("bars", "count"), [(1.96, 1), (0.98, 2), (3.0, 1)])
def test_narrow_bars_ask_for_a_field_as_much_nearer(bars: float, count: int) -> None:
    """What is left out may be 1 mm where bars are those of a normal distribution, half of it where they are half."""
    kpa = np.linspace(0, 1.25 * 50, 20)
    t = Basis.of([RANGE_KPA], 1)(kpa)[:, 1]
    modes = np.zeros((2, 2, 2))
    modes[0, 0] = modes[1, 1] = 1.0  # the first moves one node by 5 mm, the second the other without a mean
    second_mm = 0.6 / np.sqrt(((t - t.mean()) ** 2).mean() / 2)  # 0.6 mm as a root mean square of both nodes
    amplitudes = np.array([[5.0, -t.mean() * second_mm], [0.0, second_mm]])
    arrays = {"modes": modes, "amplitudes": amplitudes, "spread": np.full((2, 2, 2), 100.0), "noise_mm": np.array(1.0)}
    state = {name: torch.from_numpy(array) for name, array in {**arrays, "range_kpa": RANGE_KPA}.items()}
    state["bar_deviations"] = torch.tensor([bars, 9.0], dtype=torch.double)
    assert compressed(state)["modes"].shape[1] == count
