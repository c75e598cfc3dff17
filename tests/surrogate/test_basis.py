"""Products of Chebyshev polynomials, against NumPy's and against their definition by the cosine."""

import numpy as np
import pytest
import torch
from numpy.polynomial.chebyshev import chebvander

from pgdl_lab.surrogate.basis import Basis


def test_one_input_gives_chebyshev_polynomials_to_the_last_bit() -> None:
    basis, kpa = Basis.of([(0.0, 44.0)], 7), np.linspace(-3, 55, 40)
    assert len(basis.degrees) == 8
    np.testing.assert_array_equal(basis(kpa), chebvander((2 * kpa - 0.0 - 44.0) / (44.0 - 0.0), 7))
    np.testing.assert_array_equal(basis(kpa[:, None]), basis(kpa))
    stacked = torch.stack(basis.terms([torch.from_numpy(kpa)]), dim=-1).numpy()
    np.testing.assert_array_equal(stacked, basis(kpa))


def test_several_inputs_give_all_products_of_a_total_degree() -> None:
    basis = Basis.of([(0.0, 50.0), (-180.0, 180.0), (1.0, 3.0)], 4)
    assert len(basis.degrees) == len({*basis.degrees}) == 35  # (3 + 4)! / (3! 4!)
    assert max(sum(each) for each in basis.degrees) == 4 and basis.degrees[0] == (0, 0, 0)
    rng = np.random.default_rng(0)
    angles = rng.uniform(0, np.pi, (20, 3))
    cases = np.cos(angles) * [25.0, 180.0, 1.0] + [25.0, 0.0, 2.0]
    expected = np.array([[np.prod(np.cos(each * angle)) for each in np.array(basis.degrees)] for angle in angles])
    np.testing.assert_allclose(basis(cases), expected, atol=1e-12)


@pytest.mark.parametrize("degree", [0, 1])
def test_low_degrees(degree: int) -> None:
    values = Basis.of([(0.0, 2.0)], degree)(np.array([0.0, 1.0, 2.0]))
    np.testing.assert_array_equal(values, np.array([[1.0, -1.0], [1.0, 0.0], [1.0, 1.0]])[:, : degree + 1])
    assert Basis.of([(0.0, 2.0)], degree)(np.empty(0)).shape == (0, degree + 1)
