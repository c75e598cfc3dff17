import numpy as np
import pytest

from pgdl_lab.errors import InputError
from pgdl_lab.mechanics.material import Yeoh


def test_moduli_of_the_paper() -> None:
    material = Yeoh(c1_mpa=0.11, c2_mpa=0.02, poisson=0.49)
    assert material.shear_modulus_mpa == pytest.approx(0.22)
    assert material.lame_mpa == pytest.approx(10.78)
    assert material.bulk_modulus_mpa == pytest.approx(10.927, abs=1e-3)


def test_derivatives_against_differences() -> None:
    material, step = Yeoh(c3_mpa=0.003), 1e-5
    invariant = np.array([3.0, 3.5, 6.0])
    first, second = material.derivatives(invariant)
    above, below = material.energy(invariant + step), material.energy(invariant - step)
    np.testing.assert_allclose(first, (above - below) / (2 * step), rtol=1e-9)
    np.testing.assert_allclose(second, (above - 2 * material.energy(invariant) + below) / step**2, rtol=1e-4)


@pytest.mark.parametrize(
    ("field", "value"), [("c1_mpa", 0.0), ("c2_mpa", -0.01), ("c3_mpa", -1e-3), ("poisson", 0.5), ("poisson", -0.1)]
)
def test_refuses_what_is_no_solid(field: str, value: float) -> None:
    with pytest.raises(InputError, match=f"material.{field} is {value}"):
        Yeoh(**{field: value})
