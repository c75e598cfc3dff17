"""Which pressures and points a surrogate answers for, by hand, on a field that is the pressure itself."""

import warnings
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.export import torch_form
from pgdl_lab.surrogate.limits import Outside, TooFar
from pgdl_lab.surrogate.probe import Probe
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.surrogate import Surrogate

SQUARE = Domain(
    np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]]),
    np.array([[0, 1, 2], [1, 3, 2]]),
    base=np.array([0, 1]),
)
INSIDE = [[5.0, 5.0]]


class Constant(Probe):
    def __init__(self, points_mm: NDArray[np.float64]) -> None:
        self.points_mm = points_mm

    def value(self, kpa: float) -> NDArray[np.float64]:
        return np.full(self.points_mm.shape, kpa)


class Plain(Surrogate):
    """Says the pressure [kPa] for each displacement [mm]; its bars [mm] are x of the point by 100 and the pressure."""

    def __init__(self, ranges: dict[str, list[float]], outside: str = "raise") -> None:
        super().__init__({"name": "plain"}, Record(ranges, {}, domain=SQUARE))
        self.outside = outside

    def state(self) -> dict[str, NDArray[Any]]:
        return {}

    def probe(self, points_mm: NDArray[np.float64]) -> Probe:
        return Constant(points_mm)

    def bars(self, points_mm: NDArray[np.float64], pressures_kpa: NDArray[np.float64]) -> NDArray[np.float64]:
        return points_mm[:, 0] / 100 + np.abs(pressures_kpa)[:, None]


RANGES = [
    ([2.5, 50.0], (0.0, 50.0), (0.0, 62.5)),  # from rest on
    ([5.0, 50.0], (0.0, 50.0), (0.0, 62.5)),
    ([5.1, 50.0], (5.1, 50.0), (0.0, 62.5)),
    ([20.0, 50.0], (20.0, 50.0), (7.5, 62.5)),  # a quarter of the highest to both sides
    ([0.0, 50.0], (0.0, 50.0), (0.0, 62.5)),  # no suction
    ([-20.0, 50.0], (-20.0, 50.0), (-32.5, 62.5)),
    ([-40.0, 20.0], (-40.0, 20.0), (-50.0, 30.0)),  # of the larger in size
    ([-50.0, -10.0], (-50.0, -10.0), (-62.5, 2.5)),
    ([-50.0, 0.0], (-50.0, 0.0), (-62.5, 12.5)),
]


@pytest.mark.parametrize(("given", "trained", "allowed"), RANGES)
def test_pressures_are_answered_told_and_refused_by_how_far_they_lie(
    given: list[float], trained: tuple[float, float], allowed: tuple[float, float]
) -> None:
    surrogate = Plain({"pressure_kpa": given})
    assert surrogate.trained_kpa() == trained and surrogate.allowed_kpa() == pytest.approx(allowed)
    off = 2e-6 * max(map(abs, given))  # rounding is half as much
    asks = (surrogate.predict, lambda points, kpa: surrogate.at(points)(kpa))
    for edge, out in zip(trained, (-1, 1), strict=True):
        for ask in asks:
            assert ask(INSIDE, edge) == pytest.approx(edge) and ask(INSIDE, edge + out * off / 4) is not None
            with pytest.raises(InputError, match="outside the trained") as refused:
                ask(INSIDE, edge + out * off)
            assert isinstance(refused.value, TooFar) == (edge in allowed)
    surrogate.outside = "ignore"
    for edge, out in zip(allowed, (-1, 1), strict=True):
        for ask in (*asks, surrogate.error_bar):
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert ask(INSIDE, edge) is not None
            with pytest.raises(TooFar, match="too far outside the trained"):
                ask(INSIDE, edge + out * off)
        far = edge + out * off
        assert surrogate.at(INSIDE, beyond=True)(far) == pytest.approx(far)
        assert surrogate.predict(INSIDE, far, beyond=True) == pytest.approx(far)


@pytest.mark.parametrize(("given", "_", "allowed"), RANGES)
def test_an_exported_graph_answers_the_same_pressures(
    given: list[float], _: object, allowed: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Zero(torch_form.Graph):
        def forward(self, points_mm: torch.Tensor, pressure_kpa: torch.Tensor) -> torch.Tensor:
            return torch.zeros(len(pressure_kpa), *points_mm.shape)

    monkeypatch.setattr(torch_form, "_any_pressure", lambda _: Zero())
    graph = torch_form.graph_of(Plain({"pressure_kpa": given}))
    off = 2e-6 * max(map(abs, given))
    for edge, out in zip(allowed, (-1, 1), strict=True):
        answer = graph(torch.zeros(1, 2).double(), torch.tensor([edge + out * off / 4, edge + out * off]).double())
        assert torch.isfinite(answer[0]).all() and torch.isnan(answer[1]).all()


def test_a_surrogate_that_knows_no_pressures_answers_all() -> None:
    surrogate = Plain({})
    assert surrogate.trained_kpa() == surrogate.allowed_kpa() == (-np.inf, np.inf)
    assert surrogate.at(INSIDE)(1e9) == pytest.approx(1e9) and surrogate.predict(INSIDE, -1e9) == pytest.approx(-1e9)
    for ask in (surrogate.predict, lambda points, kpa: surrogate.at(points)(kpa)):
        with pytest.raises(InputError, match="not finite"):
            ask(INSIDE, np.inf)


@pytest.mark.parametrize(("kpa", "named"), [([-3.0, 20.0, 70.0], 70.0), ([-30.0, 60.0], -30.0), ([90.0, 70.0], 90.0)])
def test_of_several_pressures_the_farthest_is_named(kpa: list[float], named: float) -> None:
    surrogate = Plain({"pressure_kpa": [2.5, 50.0]}, outside="warn")
    with pytest.raises(TooFar, match=rf"^{named:g} kPa lies too far .* 2.5 to 50 kPa .* from 0 to 62.5, train"):
        surrogate.predict(INSIDE, kpa)
    with pytest.warns(Outside, match=rf"^{named:g} kPa lies outside .* bar of up to {abs(named) + 0.05:.2g} mm\.$"):
        surrogate.predict(INSIDE, kpa, beyond=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        surrogate.predict(INSIDE, kpa, beyond=True)  # told once


def test_of_several_points_the_farthest_is_named_and_no_bar_is_told() -> None:
    surrogate = Plain({"pressure_kpa": [2.5, 50.0]}, outside="warn")
    points = [[5.0, 5.0], [12.0, 5.0], [-3.0, 14.0], [10.0, 10.0]]
    words = r"^2 of 4 points lie off .* x = -3, z = 14 mm by 5 mm: .*, and no error bar tells how far off that is\.$"
    with pytest.warns(Outside, match=words):
        surrogate.predict(points, 10.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        surrogate.predict([[30.0, 5.0]], 10.0)  # told once
    with pytest.warns(Outside, match="^60 kPa lies outside"):  # of pressures nothing was told yet
        surrogate.at(INSIDE)(60.0)


def test_warnings_name_the_line_that_asked() -> None:
    off = [[50.0, 5.0]]
    asks = [
        lambda surrogate: surrogate.predict(INSIDE, 60.0),
        lambda surrogate: surrogate.at(INSIDE)(60.0),
        lambda surrogate: surrogate.at(INSIDE, beyond=True)(90.0),
        lambda surrogate: surrogate.predict(off, 10.0),
        lambda surrogate: surrogate.at(off),
    ]
    for ask in asks:
        with pytest.warns(Outside) as told:
            ask(Plain({"pressure_kpa": [2.5, 50.0]}, outside="warn"))
        assert [warning.filename for warning in told] == [__file__]


def test_the_same_points_are_prepared_once(monkeypatch: pytest.MonkeyPatch) -> None:
    surrogate, prepared = Plain({"pressure_kpa": [2.5, 50.0]}), []
    probe = Plain.probe
    monkeypatch.setattr(Plain, "probe", lambda self, points: (prepared.append(len(points)), probe(self, points))[1])
    points = np.array([[5.0, 5.0], [6.0, 6.0]])
    surrogate.predict(points, 10.0)
    surrogate.at(points.copy())(20.0)
    assert prepared == [2]
    points[0] = 7.0  # what was asked for is not what is asked for now
    surrogate.predict(points, 10.0)
    surrogate.predict(points[:1], 10.0)
    assert prepared == [2, 2, 1]
