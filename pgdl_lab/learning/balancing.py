"""Weights of loss terms that follow the training: the settings group `balancing`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pgdl_lab.core.errors import InputError

RULES = ("fixed", "gradient_norm", "relobralo")
LOOKBACK = 0.01  # probability with which relobralo puts what it finds against the first losses for its last factors


@dataclass(frozen=True)
class BalancingSettings:
    """How the weights of the loss terms follow the training; each is multiplied with a factor that starts from 1.

    Attributes
    ----------
    rule
        "fixed" (factors stay 1), "gradient_norm" (so that the gradients of the terms are in the ratio of their weights)
        or "relobralo" (terms that fall more slowly than others count more).
    every
        Steps from one adjustment to the next.
    memory
        Share of the old factor that an adjustment keeps, at least 0 and below 1.
    """

    rule: str = "fixed"
    every: int = 50
    memory: float = 0.9

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise InputError(f"balancing.rule is '{self.rule}'; choose one of {', '.join(RULES)}.")
        if self.every < 1:
            raise InputError(f"balancing.every is {self.every}; it must be at least 1.")
        if not 0 <= self.memory < 1:
            raise InputError(f"balancing.memory is {self.memory}; it must be at least 0 and below 1.")


class Balancer:
    """The factors of the weights.

    Parameters
    ----------
    settings
        The rule.
    names
        The terms.

    Attributes
    ----------
    factors
        Factor of each term's weight.
    """

    def __init__(self, settings: BalancingSettings, names: Iterable[str]) -> None:
        self.settings = settings
        self.factors = dict.fromkeys(names, 1.0)
        self._first: dict[str, float] = {}
        self._last: dict[str, float] = {}

    def due(self, step: int) -> bool:
        """Whether the factors are adjusted in this step."""
        return self.settings.rule != "fixed" and step % self.settings.every == 0

    def by_gradients(self, norms: Mapping[str, float]) -> None:
        """Adjust by the norms of the unweighted terms' gradients: the weaker of two gets the larger factor.

        factor ← mean norm / norm (S. Wang et al., An expert's guide to training physics-informed neural networks, 2023,
        algorithm 1). A term without a gradient, such as second derivatives of ReLU, keeps its factor.
        """
        felt = {name: norm for name, norm in norms.items() if norm > 0 and math.isfinite(norm)}
        for name, norm in felt.items():
            self._move(name, sum(felt.values()) / len(felt) / norm)

    def by_progress(self, values: Mapping[str, float], draw: float) -> None:
        """Adjust by the unweighted terms: that which has fallen least since the last time gets the largest factor.

        λ ← α λ' + (1 − α) λ̂(t, t − 1), with α the `memory` and λ̂(t, s) the shares by the terms of times t and s. λ' is
        the last λ or, where a `draw` from 0 … 1 is small, λ̂(t, 0), so that slow drifts are not lost (R. Bischof & M.
        Kraus, Multi-objective loss balancing for physics-informed deep learning, 2021, with temperature 1).
        """
        felt = {name: value for name, value in values.items() if value > 0 and math.isfinite(value)}
        if self._last and felt:
            past = self._shares(felt, self._first) if draw < LOOKBACK else self.factors
            for name, share in self._shares(felt, self._last).items():
                self.factors[name] = past[name]
                self._move(name, share)
        self._last = dict(felt)
        self._first = {**self._last, **self._first}

    @staticmethod
    def _shares(values: Mapping[str, float], before: Mapping[str, float]) -> dict[str, float]:
        """As many as there are terms, shared out by a soft maximum of value over value before."""
        ratios = {name: value / before.get(name, value) for name, value in values.items()}
        highest = max(ratios.values())
        powers = {name: math.exp(ratio - highest) for name, ratio in ratios.items()}
        return {name: len(values) * power / sum(powers.values()) for name, power in powers.items()}

    def _move(self, name: str, wanted: float) -> None:
        self.factors[name] = self.settings.memory * self.factors[name] + (1 - self.settings.memory) * wanted

    def state(self) -> dict[str, Any]:
        """What a resumed training goes on from."""
        return {"factors": dict(self.factors), "first": dict(self._first), "last": dict(self._last)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`."""
        self.factors, self._first, self._last = (dict(state[key]) for key in ("factors", "first", "last"))
