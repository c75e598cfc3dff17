"""Plane stress against the energy that is lowest over all thicknesses, and its differences."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pgdl_lab.core import registry
from pgdl_lab.mechanics.material import Material, Yeoh
from pgdl_lab.mechanics.plane_stress import PlaneStress
from pgdl_lab.mechanics.solid import InvertedElement

registry.discover()

IN_PLANE = (0, 2, 5)  # 11, 33 and 13
LAWS = [Yeoh(c3_mpa=0.003), registry.plugin("material", "ogden")()]
STATES = [(1.0, 1.0, 0.0), (1.4, 0.9, 0.2), (0.7, 1.6, -0.3), (2.5, 0.6, 0.5)]


def energy(solid: Material, plane: NDArray[np.float64]) -> float:
    """The least of W_iso + K/2 (J − 1)² over the squared stretch along y, of C₁₁, C₃₃ and C₁₃."""
    a, b, shear = plane

    def whole(across: float) -> float:
        c = np.array([a, across, b, 0.0, 0.0, shear])[:, None]
        j = np.sqrt((a * b - shear**2) * across)
        return float(solid.isochoric(c, tangent=False).energy[0] + solid.bulk_modulus_mpa / 2 * (j - 1) ** 2)

    guess = 1 / (a * b - shear**2)
    return float(
        minimize_scalar(whole, bounds=(0.5 * guess, 2 * guess), options={"xatol": 1e-10}, method="bounded").fun
    )


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("state", STATES)
def test_law_in_the_plane_is_that_of_the_thickness_with_the_least_energy(
    law: Material, state: tuple[float, float, float]
) -> None:
    plane = np.array(state)
    thin, c = PlaneStress(law), np.array([state[0], 99.0, state[1], 0.0, 0.0, state[2]])[:, None]  # 22 is not looked at
    found = thin.isochoric(c, tangent=True)
    assert found.energy[0] == pytest.approx(energy(law, plane), abs=1e-12)
    assert found.stress[1, 0] == 0 and c[1, 0] == 99.0
    assert thin.bulk_modulus_mpa == 0 and thin.shear_modulus_mpa == law.shear_modulus_mpa
    assert found.tangent is not None
    step = 1e-4
    for number, place in enumerate(IN_PLANE):
        double = 1 if place == 5 else 2  # off the diagonal a component stands for two
        change = step * np.eye(3)[number]
        slope = double * (energy(law, plane + change) - energy(law, plane - change)) / (2 * step)
        assert found.stress[place, 0] == pytest.approx(slope, abs=1e-6)
        above, below = (
            thin.isochoric(c + sign * step * np.eye(6)[place][:, None], tangent=False).stress for sign in (1, -1)
        )
        row = double * (above - below)[:, 0] / (2 * step)
        np.testing.assert_allclose(found.tangent[:, place, 0][[*IN_PLANE]], row[[*IN_PLANE]], atol=2e-6)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_points_that_are_found_at_once_wait_for_the_others(law: Material) -> None:
    c = np.array([[a, 1.0, b, 0.0, 0.0, shear] for a, b, shear in STATES]).T
    together = PlaneStress(law).isochoric(c, tangent=True)
    for number, state in enumerate(STATES):
        assert together.energy[number] == pytest.approx(energy(law, np.array(state)), abs=1e-12)
        alone = PlaneStress(law).isochoric(c[:, [number]], tangent=True)
        assert together.tangent is not None and alone.tangent is not None
        np.testing.assert_allclose(together.tangent[..., number], alone.tangent[..., 0], rtol=1e-9, atol=1e-12)


def test_what_is_no_number_has_no_thickness() -> None:
    with pytest.raises(InvertedElement):
        PlaneStress(LAWS[0]).isochoric(np.array([np.nan, 1.0, 1.0, 0.0, 0.0, 0.0])[:, None], tangent=False)
