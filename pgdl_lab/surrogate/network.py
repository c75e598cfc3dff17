"""A fully connected network that is evaluated by NumPy alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.surrogate.last_layer import STATE, LastLayer
from pgdl_lab.surrogate.probe import Case, Probe
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.surrogate import Surrogate

Floats = NDArray[np.float64]


ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {
    "relu": lambda h: np.maximum(h, 0),
    "tanh": np.tanh,
    "silu": lambda h: h * (0.5 + 0.5 * np.tanh(h / 2)),  # does not overflow
    "softplus": lambda h: np.logaddexp(0, h),
    "sin": np.sin,
}


class NetworkSurrogate(Surrogate):
    """A fully connected network of place [mm] and the inputs, as a rule the pressure [kPa], in float64.

    Parameters
    ----------
    model, record
        See `Surrogate`; the model names the "activation".
    state
        "0" … "L": scale (2, C) with shift, or weights (C', C + 1) with bias, of the layers in their order; with error
        bars also those of a `LastLayer`.
    """

    knows_body = False

    def __init__(self, model: Mapping[str, Any], record: Record, state: Mapping[str, NDArray[Any]]) -> None:
        super().__init__(model, record)
        self._state = dict(state)
        count = sum(not name.startswith(STATE) for name in state)
        self._layers = [np.asarray(state[str(number)], dtype=np.float64) for number in range(count)]
        self._last_layer = LastLayer.restored(state, record.domain)
        self._activation = ACTIVATIONS[self.model["activation"]]

    def state(self) -> dict[str, NDArray[Any]]:
        return self._state

    def probe(self, points_mm: Floats) -> Probe:
        return _NetworkProbe(self, points_mm)

    def bars(self, points_mm: Floats, cases: Floats) -> Floats | None:
        if self._last_layer is None:
            return None
        one = np.ones((len(points_mm), 1))
        features = (np.concatenate([self.hidden(np.column_stack([points_mm, case * one])), one], axis=1)
                    for case in cases)  # fmt: skip
        bars = [self._last_layer.bars(each, np.ones(1), float(far))
                for each, far in zip(features, self.along(cases), strict=True)]  # fmt: skip
        stretch = self._last_layer.stretched(self.record.domain, points_mm)
        return np.array(bars).reshape(len(cases), len(points_mm)) * stretch

    def hidden(self, inputs: Floats) -> Floats:
        """What the last layer weighs (n, H), from place and inputs (n, d + D)."""
        first, *hidden, _, _ = self._layers
        values = inputs * first[0] + first[1]
        for layer in hidden:
            values = self._activation(values @ layer[:, :-1].T + layer[:, -1])
        return values

    def outputs(self, inputs: Floats) -> Floats:
        """Displacements (n, d) [mm] from place and inputs (n, d + D)."""
        *_, last, scaling = self._layers
        return (self.hidden(inputs) @ last[:, :-1].T + last[:, -1]) * scaling[0] + scaling[1]


class _NetworkProbe(Probe):
    def __init__(self, surrogate: NetworkSurrogate, points_mm: Floats) -> None:
        self._surrogate, self._points_mm = surrogate, points_mm

    def value(self, case: Case) -> Floats:
        inputs = case * np.ones((len(self._points_mm), 1))
        return self._surrogate.outputs(np.column_stack([self._points_mm, inputs]))
