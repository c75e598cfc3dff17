"""How far a network may err: the Laplace approximation of its last layer, scaled to errors that it was seen to make.

Hidden layers are taken as they are and the last one as a Bayesian linear regression on their outputs φ (D. MacKay,
Bayesian interpolation, 1992; E. Daxberger et al., Laplace redux, 2021). The variance of its prediction at a place is
1 + φᵀ (Φᵀ Φ + ρ I)⁻¹ φ times that of the noise, where Φ holds the φ of the training points: it grows where φ is unlike
all of them. Hidden layers err too: where a field is a polynomial in the pressure, so is its error, which then grows
beyond the trained pressures as polynomials do. NumPy is all it needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.surrogate.calibration import ABOVE, covering, covering_line

Floats = NDArray[np.float64]
Features = tuple[Floats, Floats]

ROUNDS = 20  # of the fixed-point iteration for ρ, whose factor from one to the next is then below a percent
BANDS, LEAST = 5, 100  # of the pressure, each scaled by itself, and the least number of samples in one
BEYOND = np.linspace(0.1, 1.0, 10) ** 2  # of the highest trained pressure: how far above it bars are told for
STATE = "bars."  # begins the names of its arrays in the state of a surrogate


@dataclass(frozen=True)
class LastLayer:
    """Error bars of a network.

    The outputs of the last layer are sums over products φ of H features of the place and K of the pressure.

    Attributes
    ----------
    roots
        (K, H, K H), a root R of (Φᵀ Φ + ρ I)⁻¹ = R Rᵀ.
    kpa, bar_mm
        (B,) each: how far along, see `limits.along`, within what was trained and above it, and what the root of the
        variance is multiplied by there [kPa, mm].
    stretch
        (N,), how many times wider bars are at the points of the body; None: nowhere, as no stretch of it is without
        training points.
    """

    roots: NDArray[np.float32]
    kpa: Floats
    bar_mm: Floats
    stretch: Floats | None = None

    @classmethod
    def fitted(
        cls,
        features: Features,
        pressures_kpa: Floats,
        targets_mm: Floats,
        errors_mm: Floats,
        held: NDArray[np.bool_],
        above: Floats,
        scores_mm: Floats | None = None,
    ) -> LastLayer:
        """Error bars that cover 95 % of the errors at the samples set aside, or at all if there are none.

        Where it is known how networks err that were trained without each sample, the bars cover 95 % of that. Errors at
        training points themselves are counted as those of a last layer that was fitted without each, by the formula of
        leaving one out. Beyond the trained pressures the bars also hold what it costs to fit the last layer without the
        highest of them and to predict those, more than to predict the ones in between. All of that grows there as the
        standard deviation of a polynomial in the pressure does that has noise at all samples.

        Parameters
        ----------
        features
            (n, H) and (n, K), of place and inputs at n samples.
        pressures_kpa, targets_mm, errors_mm
            (n,), (n, 2) and (n, 2), of the samples: how far along they are, what the last layer was to give, and what
            the network errs by.
        held
            (n,), the samples that it did not learn from.
        above
            (len(BEYOND), K), features of the inputs that lie as far above the highest along the first.
        scores_mm
            (n, 2), |error| by the root of its variance of networks that were trained without each sample; None: they
            are not known.
        """
        products = _products(features)
        root, _, _ = ridge_regression(products[~held], targets_mm[~held])
        leverage = ((products @ root) ** 2).sum(axis=1)
        alone = errors_mm if held.any() else errors_mm / (1 - leverage)[:, None]
        judged = held if held.any() else np.ones(len(held), dtype=bool)
        highest = float(pressures_kpa.max())
        if scores_mm is None:
            kpa, bar_mm = _inside(pressures_kpa[judged], _ratios(alone[judged], leverage[judged]), highest)
        else:
            kpa, bar_mm = _inside(pressures_kpa, scores_mm, highest)
        top = pressures_kpa > (1 - ABOVE) * highest
        below = ~top & ~held
        more = 0.0
        if below.sum() > products.shape[1] and top.any():
            root_below, weights, _ = ridge_regression(products[below], targets_mm[below])
            leverage_below = ((products @ root_below) ** 2).sum(axis=1)
            missed = products @ weights - targets_mm
            known = _quantile(missed[below] / (1 - leverage_below[below])[:, None], leverage_below[below])
            more = max(_quantile(missed[top], leverage_below[top]) ** 2 - known**2, 0.0)
        kpa += [highest, *((1 + BEYOND) * highest)]
        grown = np.hypot(bar_mm[-1], np.sqrt(more) * np.minimum(BEYOND / ABOVE, 1))
        bar_mm += list(grown * _growth(features[1], features[1][pressures_kpa.argmax()], above))
        hidden, orders = (part.shape[1] for part in features)
        roots = root.reshape(orders, hidden, -1).astype(np.float32)
        return cls(roots, np.array(kpa), np.array(bar_mm))

    @classmethod
    def restored(cls, state: Mapping[str, NDArray[Any]], domain: Domain | None = None) -> LastLayer | None:
        """That of the state of a surrogate on a domain; None where it has none.

        Raises
        ------
        ValueError
            When its stretch is not one of the points of the domain.
        """
        roots, kpa, bar_mm, stretch = (state.get(STATE + name) for name in ("roots", "kpa", "bar_mm", "stretch"))
        if roots is None or kpa is None or bar_mm is None:
            return None
        if stretch is not None and (domain is None or stretch.shape != domain.points_mm[:, 0].shape):
            raise ValueError(f"{STATE}stretch is {stretch.shape}")
        return cls(roots, kpa, bar_mm, stretch)

    def state(self) -> dict[str, NDArray[Any]]:
        """What the state of a surrogate holds of it."""
        return {STATE + name: array for name, array in vars(self).items() if array is not None}

    def stretched(self, domain: Domain | None, points_mm: Floats) -> Floats:
        """How many times wider bars are at points (n, 2) [mm] of the domain."""
        if self.stretch is None or domain is None:
            return np.ones(len(points_mm))
        corners, weights = domain.locate(points_mm)
        return (weights * self.stretch[corners]).sum(axis=1)

    def bars(self, place: Floats, pressure: Floats, kpa: float) -> Floats:
        """Error bars (n,) [mm] from features (n, H) of the place and (K,) of inputs `kpa` along, not `stretched`."""
        # of what is rotated in the end only the lengths count
        _, triangle = np.linalg.qr(np.einsum("k,khf->fh", pressure, self.roots))
        variance = 1 + ((place @ triangle.T) ** 2).sum(axis=1)
        return np.interp(kpa, self.kpa, self.bar_mm) * np.sqrt(variance)


def _growth(trained: Floats, highest: Floats, above: Floats) -> Floats:
    """Standard deviation of a fit with noise at all samples (n, K): above (M, K) the highest (K,), by that at it."""
    # pressures fewer than orders leave some of these untold: they do not count
    information = np.linalg.pinv(trained.T @ trained)
    variance = np.einsum("mk,kl,ml->m", above, information, above) / (highest @ information @ highest)
    growth: Floats = np.sqrt(np.maximum.accumulate(np.maximum(variance, 1.0)))
    return growth


def _inside(pressures_kpa: Floats, ratios: Floats, highest: float) -> tuple[list[float], list[float]]:
    """What 95 % of such ratios (m, 2) lie below at some pressures and, at last, at the highest, which is not named.

    Many are told in bands of the pressure, fewer by a line.
    """
    rising = np.argsort(pressures_kpa, kind="stable")
    bands = np.array_split(rising, np.clip(len(rising) // LEAST, 1, BANDS))
    if len(bands) == 1:
        return [0.0], list(covering_line(pressures_kpa / highest, ratios))
    return [float(np.median(pressures_kpa[band])) for band in bands[:-1]], [covering(ratios[band]) for band in bands]


def _ratios(errors_mm: Floats, leverage: Floats) -> Floats:
    """|errors| (n, 2) by the roots of their variances 1 + `leverage` (n,) [mm]."""
    ratios: Floats = np.abs(errors_mm) / np.sqrt(1 + leverage)[:, None]
    return ratios


def _quantile(errors_mm: Floats, leverage: Floats) -> float:
    """What 95 % of errors like these (n, 2), by the roots of their variances 1 + `leverage` (n,), lie below [mm]."""
    return covering(_ratios(errors_mm, leverage))


def ridge(features: Features, targets_mm: Floats) -> float:
    """The likeliest ρ for features of place and pressure, (n, H) and (n, K), and what they shall give (n, 2)."""
    return ridge_regression(_products(features), targets_mm)[2]


def scores(errors_mm: Floats, features: Features, trained: Features, rho: float) -> Floats:
    """|error| (m, 2) [mm] at samples with `features`, by the root of its variance where those `trained` are known."""
    root, _, _ = ridge_regression(_products(trained), np.zeros((len(trained[0]), errors_mm.shape[1])), rho)
    variance = 1 + ((_products(features) @ root) ** 2).sum(axis=1)
    result: Floats = np.abs(errors_mm) / np.sqrt(variance)[:, None]
    return result


def _products(features: Features) -> Floats:
    """(n, K H) from (n, H) and (n, K)."""
    return np.einsum("nh,nk->nkh", *features).reshape(len(features[0]), -1)


def ridge_regression(features: Floats, targets: Floats, rho: float | None = None) -> tuple[Floats, Floats, float]:
    """A root (F, F) of (Φᵀ Φ + ρ I)⁻¹, weights (F, 2) of ridge regression on Φ (n, F), and ρ (None: the likeliest)."""
    values, vectors = np.linalg.eigh(features.T @ features)
    values = np.maximum(values, np.finfo(float).eps * values[-1])
    onto = vectors.T @ (features.T @ targets)
    if rho is None:
        rho = _likeliest(values, onto, targets)
    return vectors / np.sqrt(values + rho), vectors @ (onto / (values + rho)[:, None]), rho


def _likeliest(values: Floats, onto: Floats, targets: Floats) -> float:
    total, count = (targets**2).sum(), targets.size
    if not total:
        return np.inf  # weights of zero explain all
    rho = values[-1] * 1e-9
    for _ in range(ROUNDS):
        weights = onto / (values + rho)[:, None]
        used = targets.shape[1] * (values / (values + rho)).sum()  # degrees of freedom
        left = max(total - (weights * (2 * onto - values[:, None] * weights)).sum(), np.finfo(float).eps * total)
        rho = used / (weights**2).sum() * left / max(count - used, 1.0)
    return float(rho)
