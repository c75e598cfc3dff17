"""Each term of a loss by hand, in fields where no part of it is zero or too small to be seen."""

from dataclasses import replace

import pytest
import torch

from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.jet import Jet
from tests.trainings import scene, small

discover()


@pytest.mark.parametrize(
    ("form", "wanted"),
    [
        # (λ + μ) (u_x,xx + u_z,xz) + μ ∇²u_x + f_x and (λ + μ) (u_x,xz + u_z,zz) + μ ∇²u_z + f_z
        ("corrected", (10.5 * (1 + 11) + 0.5 * (1 + 2) + 0.3, 10.5 * (3 + 7) + 0.5 * (5 + 7) - 0.7)),
        # (λ + μ) ∂(u_x + u_z)/∂x + … and (λ + μ) ∂(u_x + u_z)/∂z + …
        ("published", (10.5 * (1.1 + 1.3) + 0.5 * (1 + 2) + 0.3, 10.5 * (1.7 + 1.9) + 0.5 * (5 + 7) - 0.7)),
    ],
)
def test_navier_cauchy_of_a_field_with_all_derivatives_and_a_force_that_counts(
    form: str, wanted: tuple[float, float]
) -> None:
    values = [[0.0, 0.0], [1.1, 1.3], [1.7, 1.9], [1.0, 5.0], [2.0, 7.0], [3.0, 11.0]]  # u, ∂x, ∂z, ∂xx, ∂zz, ∂xz
    jet = Jet(torch.tensor(values, dtype=torch.double)[:, None])
    body = replace(scene(small()), body_force_n_mm3=(0.3, -0.7))
    found = plugin("loss", "navier_cauchy")(form=form).residuals(jet, body)
    assert [float(part) for part in found] == pytest.approx(wanted)
