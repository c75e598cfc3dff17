"""Scales of a network, ranges of a field on modes, and the edges of what models can be set to."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.data import Samples
from tests.trainings import small, training

discover()


@pytest.mark.parametrize("interval", [[-1.0, 1.0], [0.0, 1.0], [2.0, 5.0]])
def test_inputs_and_outputs_of_a_network_are_scaled_to_its_interval(interval: list[float], tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}})
    points = np.array([[10.0, -3.0], [30.0, 5.0], [20.0, 0.0]])
    moved = np.array([[-4.0, 1.0], [2.0, 9.0], [0.0, 3.0]])
    samples = Samples(points, Cases.path(np.array([20.0, 50.0, 5.0])), moved)
    model = plugin("model", "mlp")(depth=1, width=4, dtype="float64", interval=interval)
    inwards, *layers, outwards = model.new_field(replace(how, samples=samples)).layers
    low, high = interval
    ends = torch.tensor([[10.0, -3.0, 5.0], [30.0, 5.0, 50.0]], dtype=torch.double)
    assert inwards(ends).numpy() == pytest.approx(np.array([[low] * 3, [high] * 3]))
    assert (layers[0].in_features, layers[-1].out_features) == (3, 2)
    inner = torch.tensor([[low, low], [high, high]], dtype=torch.double)
    assert outwards(inner).numpy() == pytest.approx(np.array([[-4.0, 1.0], [2.0, 9.0]]))


def test_a_range_of_width_zero_is_scaled_as_if_it_were_1_wide(tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}})
    samples = replace(how.samples, cases=Cases.path(np.full(len(how.samples), 30.0)))
    inwards, *_ = (
        plugin("model", "mlp")(depth=1, width=4, dtype="float64").new_field(replace(how, samples=samples)).layers
    )
    asked = torch.tensor([[0.0, 0.0, 30.0], [0.0, 0.0, 31.0]], dtype=torch.double)
    assert inwards(asked)[:, 2].tolist() == pytest.approx([-1.0, 1.0])


@pytest.mark.parametrize("interval", [[1.0, 1.0], [1.0, -1.0], [0.0], [0.0, 1.0, 2.0]])
def test_an_interval_is_two_rising_numbers(interval: list[float]) -> None:
    with pytest.raises(InputError, match="give two rising numbers"):
        plugin("model", "mlp")(interval=interval)


def test_a_field_on_modes_begins_at_0_kpa_and_has_as_many_modes_as_a_quarter_of_the_points(tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}})
    for modes, kept in ((7, 7), (10**6, len(small().domain.points_mm) // 4)):
        field = plugin("model", "body")(depth=1, width=4, degree=1, modes=modes).new_field(how)
        assert field.range_kpa.tolist() == pytest.approx([0.0, how.samples.pressures_kpa.max()])
        assert field.modes.shape == (len(small().domain.points_mm), kept)


@pytest.mark.parametrize(
    ("name", "least", "wrong", "sentence"),
    [
        ("body", {"modes": 1, "degree": 1}, {"modes": 0}, "model.modes is 0; it must be at least 1"),
        ("body", {"modes": 1, "degree": 1}, {"degree": 0}, "model.degree is 0; it must be at least 1"),
        ("pod", {"rounds": 0}, {"rounds": -1}, "model.rounds is -1; it must not be negative"),
        (
            "pod",
            {"degree": 3, "draws": 4},
            {"degree": 3, "draws": 3},
            r"model.draws is 3; as many as polynomials \(4\)",
        ),
        ("hybrid", {"degree": 1, "correction_degree": 1}, {"degree": 0}, "model.degree is 0; it must be at least 1"),
        ("hybrid", {"correction_degree": 0}, {"correction_degree": -1}, "model.correction_degree is -1; .* least 0"),
        ("hybrid", {"rounds": 0}, {"rounds": -1}, "model.rounds is -1; it must be at least 0"),
        ("hybrid", {"degree": 3, "correction_degree": 3}, {"degree": 3, "correction_degree": 4}, "not be above"),
        ("hybrid", {"dtype": "float64"}, {"dtype": "float32"}, "model.dtype of hybrid is float64"),
    ],
)
def test_the_least_is_taken_and_less_is_refused(
    name: str, least: dict[str, Any], wrong: dict[str, Any], sentence: str
) -> None:
    plugin("model", name)(**least)
    with pytest.raises(InputError, match=sentence):
        plugin("model", name)(**wrong)


@pytest.mark.parametrize(("degree", "draws"), [(3, 16), (15, 16), (16, 17), (30, 31)])
def test_error_bars_come_from_16_draws_and_from_as_many_as_there_are_polynomials(
    degree: int, draws: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fewer draws than polynomials would not span what is not known of them."""
    monkeypatch.setattr("pgdl_lab.learning.pod.decompose", lambda regression, prior, draws, rng: (prior, draws))
    regression = SimpleNamespace(first_prior=lambda: "not learnt")
    model = plugin("model", "finite_element")(degree=degree)
    assert model.learn(regression, training(tmp_path, {"data": {}})) == ("not learnt", draws)
