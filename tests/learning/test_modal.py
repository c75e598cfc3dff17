from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.surrogate.triangulation import Triangulation
from tests.trainings import small, training

discover()


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Any:
    model = plugin("model", "body")(modes=16, depth=1, width=8, degree=3, dtype="float64")
    return model.new_field(training(tmp_path_factory.mktemp("modal"), {"data": {}}))


def test_starts_from_the_least_squares_fit(field: Any) -> None:
    data = small()
    with torch.no_grad():
        start = field.displacements(
            field.coordinates(data.domain.points_mm, 0), torch.from_numpy(data.cases.values)
        ).numpy()
    spread = (data.displacements - data.displacements.mean(axis=1, keepdims=True)) ** 2
    assert ((start - data.displacements) ** 2).mean() < 0.01 * spread.mean()


def test_polynomials_are_chebyshevs_and_go_on_beyond_the_range(field: Any) -> None:
    kpa = np.array([0.0, 20.0, 50.0, 60.0])
    expected = np.polynomial.chebyshev.chebvander(2 * kpa / 50 - 1, 3)
    assert field.polynomials(torch.from_numpy(kpa[:, None])).numpy() == pytest.approx(expected)


def test_coordinates_hold_the_modes_and_their_derivatives(field: Any) -> None:
    data = small()
    rows = field.coordinates(data.domain.points_mm, 2).numpy()
    modes = field.modes.numpy()
    assert rows[0] == pytest.approx(modes)
    for row, matrix in zip(rows[1:], Triangulation(data.domain.points_mm, data.domain.cells).derivatives, strict=True):
        assert row == pytest.approx(matrix @ modes)


def test_jet_follows_the_chain_rule_through_the_modes(field: Any) -> None:
    """Directional derivatives of the field by its coordinates, joined with the coordinates' own, give the same rows."""
    torch.manual_seed(0)
    for weight in field.deep.parameters():
        torch.nn.init.normal_(weight, std=0.3)
    rows, kpa = (
        field.coordinates(small().domain.points_mm[:5], 2),
        torch.tensor([[5.0], [10], [20], [30], [50]], dtype=torch.double),
    )
    step = 1e-4

    def along(a: float, b: float) -> torch.Tensor:
        taylor = rows[0] + a * rows[1] + b * rows[2] + a * a / 2 * rows[3] + b * b / 2 * rows[4] + a * b * rows[5]
        return field(taylor[None], kpa)

    with torch.no_grad():
        jet = field.jet(rows, kpa, 2)
        first = (along(step, 0) - along(-step, 0)) / (2 * step)
        mixed = (along(step, step) - along(step, -step) - along(-step, step) + along(-step, -step)) / (4 * step**2)
        second = (along(0, step) - 2 * along(0, 0) + along(0, -step)) / step**2
    assert torch.allclose(jet.gradient[:, :, 0], first, rtol=1e-5, atol=1e-6)
    assert torch.allclose(jet.hessian[:, :, 2], mixed, rtol=1e-4, atol=1e-4)
    assert torch.allclose(jet.hessian[:, :, 1], second, rtol=1e-4, atol=1e-4)
