"""Regression of a displacement field by Gaussian processes whose covariance separates into place and inputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.learning.clock import Clock
from pgdl_lab.learning.data import Samples
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.triangulation import Triangulation

Floats = NDArray[np.float64]

RIDGE = 1e-9  # precision of what neither the kinks nor the data fix; against 1 for a kink
NOISE_FLOOR = (
    1e-6  # least standard deviation of the noise, by the root mean square of the data: keeps digits for solves
)

ROUGH = 4.0  # standard deviation of a kink where a rough field has one of mean size, by that where it has none

FIRST_DECAY = 0.2  # of the kinks from one order in the pressure to the next, before anything is known of them
FIRST_NOISE = 3e-6  # standard deviation of the noise by the root mean square of the data, likewise


@dataclass(frozen=True)
class Prior:
    """What is assumed of the field before the data are seen.

    Attributes
    ----------
    covariance
        (K, K), of the kinks of the coefficients of K Chebyshev polynomials in the inputs, from one to another.
    noise_mm
        Standard deviation of what the data err by [mm].
    """

    covariance: Floats
    noise_mm: float

    @classmethod
    def falling(cls, slope: float, decay: float, orders: NDArray[np.int64], noise_mm: float) -> Prior:
        """Polynomials of `orders` (K,) that know nothing of each other, whose kinks fall by `decay` per order."""
        return cls(np.diag((slope * decay**orders) ** 2), noise_mm)

    @cached_property
    def amplitudes(self) -> Floats:
        """(K, K), a square root of the covariance: columns are modes of the inputs, the strongest first."""
        variances, directions = np.linalg.eigh(self.covariance)
        return (directions * np.sqrt(np.maximum(variances, np.finfo(float).tiny)))[:, ::-1]


@dataclass(frozen=True)
class Posterior:
    """What is known of the field after the data were seen: u(x, p) = Σ modes(x) · amplitudes(p), p all inputs.

    Attributes
    ----------
    prior
        What was assumed.
    modes
        (N, K, k), the mean at the nodes; the prior's amplitudes carry the unit [mm].
    draws
        (N, K, S), random draws of the deviation from the mean, which is alike for all k components.
    """

    prior: Prior
    modes: Floats
    draws: Floats


def evaluated(nodal: Floats, body: Triangulation, samples: Samples, highest_kpa: float) -> Floats:
    """Displacements (n, k) [mm] at the samples of Chebyshev coefficients (N, D, k) at the nodes, from 0 kPa on [mm]."""
    corners, weights = body.locate(samples.points_mm)
    polynomials = Basis.of([(0.0, highest_kpa)], nodal.shape[1] - 1)(samples.cases.values)
    return np.einsum("nc,nd,ncdi->ni", weights, polynomials, nodal[corners], optimize=True)


class SeparableRegression:
    """Coefficients of hat functions on the body times Chebyshev polynomials in the inputs, from scattered data.

    A priori the kinks of the field (see `Triangulation.kinks`) are independent Gaussian variables, each a polynomial in
    the inputs with one covariance K × K for all. That is thin-plate smoothing along the body with its own weight for
    each mode of the inputs, and the posterior mean is one sparse linear least-squares solve for all components.
    The covariance is learnt by expectation-maximisation (C. Bishop, Pattern Recognition and Machine Learning, 2006,
    section 9.4), and what the data err by from the degrees of freedom that the fit leaves them (D. MacKay, Bayesian
    interpolation, 1992). Its principal axes are the proper orthogonal modes of the field, found from scattered points.

    Parameters
    ----------
    body
        The triangulated body.
    clamp
        (C,), nodes whose displacement is zero.
    samples
        The data.
    basis
        The polynomials.
    rough
        (N, …), a field at the nodes whose kinks tell where to expect more: a priori each is as much larger as those of
        that are at its edge; None: nothing is known of this.
    clock
        The time that all fits together may take.
    """

    def __init__(
        self,
        body: Triangulation,
        clamp: NDArray[np.int64],
        samples: Samples,
        basis: Basis,
        rough: Floats | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._clock = clock or Clock(np.inf)
        self._longest_s = 0.0  # that a fit has taken so far
        self.samples = samples
        self.orders = np.array(basis.degrees).sum(axis=1)  # of each polynomial
        self.length_mm = float(np.linalg.norm(np.ptp(body.points_mm, axis=0)))
        self.nodes = len(body.points_mm)
        self.free = np.setdiff1d(np.arange(self.nodes), clamp)
        self.body_mm, self.clamp_mm = body.points_mm, body.points_mm[clamp]
        self.kinks = body.kinks[:, self.free]
        if rough is not None:
            there = np.linalg.norm(body.kinks @ rough.reshape(self.nodes, -1), axis=1)
            self.kinks = sp.diags(1 / np.hypot(1, ROUGH * there / np.sqrt((there**2).mean()))) @ self.kinks
        corners, weights = body.locate(samples.points_mm)
        row = np.repeat(np.arange(len(corners)), corners.shape[1])
        hats = sp.csr_matrix((weights.ravel(), (row, corners.ravel())), shape=(len(corners), self.nodes))[:, self.free]
        hats.data[np.abs(hats.data) < 1e-9] = 0  # a point at a node has one weight, not several
        hats.eliminate_zeros()
        self.hats = hats
        self._solver = symmetric_solver()
        self.polynomials = basis(samples.cases.values)

    def allows(self, fits: int) -> bool:
        """Whether there is time for so many fits more, each as long as the longest so far."""
        left_s = self._clock.left_s
        return left_s > 0 and left_s >= fits * self._longest_s

    def first_prior(self) -> Prior:
        """A prior that is wide for any finger: kinks up to the mean slope of the displacement, little noise.

        Raises
        ------
        InputError
            When no training point moves.
        """
        size_mm = float(np.sqrt((self.samples.displacements_mm**2).mean()))
        if size_mm == 0:
            raise InputError("The displacement of every training point is 0 mm: there is nothing to learn from.")
        return Prior.falling(size_mm / self.length_mm, FIRST_DECAY, self.orders, FIRST_NOISE * size_mm)

    def posterior(
        self,
        prior: Prior,
        draws: int,
        rng: np.random.Generator,
        kept: NDArray[np.bool_] | None = None,
        targets_mm: Floats | None = None,
    ) -> Posterior:
        """Mean and random draws of the field given the samples, or those that are `kept` (n,).

        Where they are given, `targets_mm` (n, k) stand in for the displacements of the samples.

        A draw of the deviation is the fit to noise of its own (G. Papandreou & A. Yuille, Gaussian sampling by local
        perturbations, 2010).
        """
        began_s = self._clock.seconds
        order = len(self.orders)
        scaled = self.polynomials @ prior.amplitudes / prior.noise_mm
        # what is left out counts with weight 0, so that the pattern of the matrix and its ordering stay
        design = self._products(self.hats, scaled if kept is None else scaled * kept[:, None])
        kinks = sp.kron(self.kinks, sp.identity(order), format="csr")
        normal = design.T @ design + kinks.T @ kinks + RIDGE * sp.identity(design.shape[1])
        noise = rng.standard_normal((design.shape[0], draws)), rng.standard_normal((kinks.shape[0], draws))
        targets_mm = self.samples.displacements_mm if targets_mm is None else targets_mm
        data = design.T @ (targets_mm / prior.noise_mm)
        self._solver.factorise(sp.triu(normal, format="csr"))
        solution = self._solver.solve(np.concatenate([data, design.T @ noise[0] + kinks.T @ noise[1]], axis=1))
        components = targets_mm.shape[1]
        everywhere = np.zeros((self.nodes, order, components + draws))
        everywhere[self.free] = solution.reshape(len(self.free), order, -1)
        self._longest_s = max(self._longest_s, self._clock.seconds - began_s)
        return Posterior(prior, everywhere[..., :components], everywhere[..., components:])

    def close(self) -> None:
        """Give back the memory of the factors."""
        self._solver.close()

    @staticmethod
    def _products(hats: sp.csr_matrix, polynomials: Floats) -> sp.csr_matrix:
        """(n, N K): rows are the products of a row of `hats` (n, N) and one of `polynomials` (n, K)."""
        order = polynomials.shape[1]
        counts = np.diff(hats.indptr)
        columns = hats.indices[:, None] * order + np.arange(order)
        values = hats.data[:, None] * np.repeat(polynomials, counts, axis=0)
        shape = (hats.shape[0], hats.shape[1] * order)
        return sp.csr_matrix((values.ravel(), columns.ravel(), hats.indptr * order), shape=shape)

    def at_samples(self, posterior: Posterior) -> tuple[Floats, Floats]:
        """Mean (n, k) and draws of the deviation (n, S) at all samples [mm]."""
        polynomials = self.polynomials @ posterior.prior.amplitudes

        def evaluated(nodal: Floats) -> Floats:
            count = nodal.shape[2]
            local = (self.hats @ nodal[self.free].reshape(len(self.free), -1)).reshape(len(polynomials), -1, count)
            return np.einsum("nk,nkc->nc", polynomials, local)

        return evaluated(posterior.modes), evaluated(posterior.draws)

    def learnt(self, posterior: Posterior) -> Prior:
        """The prior that explains the data better than the one that `posterior` was found with."""
        prior, draws = posterior.prior, posterior.draws.shape[2]
        order = len(prior.covariance)

        def second_moment(nodal: Floats) -> Floats:
            kinks = (self.kinks @ nodal[self.free].reshape(len(self.free), -1)).reshape(-1, order, nodal.shape[2])
            return np.einsum("ekc,elc->kl", kinks, kinks)

        components = posterior.modes.shape[2]
        moment = second_moment(posterior.modes) / components + second_moment(posterior.draws) / draws
        covariance = prior.amplitudes @ moment @ prior.amplitudes.T / len(self.free)
        mean, deviation = self.at_samples(posterior)
        data = self.samples.displacements_mm
        used = (deviation**2).sum(axis=0).mean() / prior.noise_mm**2  # degrees of freedom per component
        left = max(len(data) - used, 1e-2 * len(data))
        noise_mm = np.sqrt(((mean - data) ** 2).sum() / components / left)
        return Prior(covariance, max(noise_mm, NOISE_FLOOR * np.sqrt((data**2).mean())))
