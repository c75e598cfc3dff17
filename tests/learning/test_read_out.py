"""Fields whose last layer is linear: what it weighs, and what a field on modes starts from."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.surrogate.triangulation import Triangulation
from tests.trainings import small, training

discover()
KPA = torch.tensor([[5.0], [10], [20], [30], [60]], dtype=torch.double)


def new_field(name: str, folder: Path, **fields: Any) -> Any:
    """A field in float64 with random weights."""
    model = plugin("model", name)(depth=1, width=6, dtype="float64", **fields)
    field = model.new_field(training(folder, {"data": {}}))
    torch.manual_seed(0)
    with torch.no_grad():
        for weight in field.parameters():
            torch.nn.init.normal_(weight, std=0.3)
    return field


def test_the_last_layer_of_a_field_on_modes_weighs_products_of_its_features(tmp_path: Path) -> None:
    field = new_field("body", tmp_path, modes=16, degree=3)
    coordinates = field.coordinates(small().domain.points_mm[:5], 0)
    with torch.no_grad():
        first, second = (part.numpy() for part in field.features(coordinates, KPA))
        beside, whole = field.beside(coordinates, KPA).numpy(), field(coordinates, KPA).numpy()
        apart = field.displacements(coordinates, KPA).numpy()  # all points at all pressures
    last = field.deep[-1]
    weights = np.concatenate([last.weight.detach().numpy(), last.bias.detach().numpy()[:, None]], axis=1)
    weights = weights.reshape(4, 2, -1)  # (K, 2, H)
    assert first.shape == (5, 7) and second.shape == (5, 4)
    for n in range(5):
        products = sum(weights[k] @ first[n] * second[n, k] for k in range(4))
        np.testing.assert_allclose(whole[n], beside[n] + products, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(apart[n, n], whole[n], rtol=1e-12, atol=1e-12)
    assert apart.shape == (5, 5, 2) and np.abs(beside).min() > 1e-3


def test_the_last_layer_of_a_network_weighs_what_comes_before_the_scale(tmp_path: Path) -> None:
    field = new_field("mlp", tmp_path)
    coordinates = field.coordinates(small().domain.points_mm[:5], 1)
    with torch.no_grad():
        first, second = (part.numpy() for part in field.features(coordinates, KPA))
        whole, apart = field(coordinates, KPA).numpy(), field.displacements(coordinates[:1], KPA).numpy()
        assert not field.beside(coordinates, KPA).any()
    *_, last, scale = field.layers
    weights = np.concatenate([last.weight.detach().numpy(), last.bias.detach().numpy()[:, None]], axis=1)
    wanted = (first * second) @ weights.T * scale.scale.numpy() + scale.shift.numpy()
    np.testing.assert_allclose(whole, wanted, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(apart[range(5), range(5)], wanted, rtol=1e-12, atol=1e-12)
    assert field.displacements(coordinates[:1], KPA[:0]).shape == (0, 5, 2)


def test_a_field_on_modes_starts_from_the_ridge_regression_of_its_samples(tmp_path: Path) -> None:
    """Mode m in the k-th polynomial costs 1e-2 ((λ_m/λ_max)² + 1e-6) 256^k a sample: as rows below the samples'."""
    given = training(tmp_path, {"data": {}})
    field = plugin("model", "body")(depth=1, width=6, dtype="float64", modes=12, degree=2).new_field(given)
    body = Triangulation(given.scene.domain.points_mm, given.scene.domain.cells)
    modes, eigenvalues = body.modes(12)
    samples = given.samples
    at_samples = modes[[np.flatnonzero((body.points_mm == point).all(axis=1))[0] for point in samples.points_mm]]
    low, high = field.range_kpa.tolist()
    t = (2 * samples.pressures_kpa - low - high) / (high - low)
    basis = np.insert(at_samples, 0, 1.0, axis=1)
    design = np.concatenate([basis * each[:, None] for each in (np.ones_like(t), t, 2 * t * t - 1)], axis=1)
    roughness = np.insert((eigenvalues / eigenvalues.max()) ** 2, 0, 0.0) + 1e-6
    cost = 1e-2 * len(t) * np.concatenate([roughness * 256.0**k for k in range(3)])
    rows = np.concatenate([design, np.diag(np.sqrt(cost))])
    targets = np.concatenate([samples.displacements_mm, np.zeros((len(cost), 2))])
    wanted = np.linalg.lstsq(rows, targets)[0]
    with torch.no_grad():
        found = field(field.coordinates(samples.points_mm, 0), torch.from_numpy(samples.cases.values)).numpy()
    np.testing.assert_allclose(found, design @ wanted, rtol=1e-6, atol=1e-6)
    assert not field.deep[-1].weight.any() and not field.deep[-1].bias.any()
