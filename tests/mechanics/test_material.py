from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.invariants import COLUMNS, ROWS
from pgdl_lab.mechanics.material import Material, Yeoh

registry.discover()

Array = NDArray[np.float64]


def make(name: str, **fields: Any) -> Material:
    made: Material = registry.plugin("material", name)(**fields)
    return made


def components(tensor: Array) -> Array:
    """The six components of a symmetric tensor (…, 3, 3), first."""
    return np.moveaxis(tensor, (-2, -1), (0, 1))[ROWS, COLUMNS]


def turned(*stretches: float) -> Array:
    """Right Cauchy–Green tensor (6, 1) of principal `stretches` along axes that are not those of the components."""
    axes, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return components((axes * np.square(stretches)) @ axes.T)[:, None]


UNIAXIAL = (1.5, 1.5**-0.5, 1.5**-0.5)
STATES = {
    "undeformed": components(np.eye(3))[:, None],
    "swollen": turned(1.2, 1.2, 1.2),
    "uniaxial": turned(*UNIAXIAL),
    "almost uniaxial": turned(1.5, 1.5**-0.5, 1.5**-0.5 * (1 + 1e-9)),
    "equibiaxial": turned(1.4, 1.4, 1.4**-2),
    "three stretches": turned(1.3, 0.9, 1.1),
}
LAWS = {
    **{name: make(name) for name in registry.names("material") if name in ("yeoh", "mooney_rivlin", "ogden")},
    "yeoh, third order": Yeoh(c3_mpa=0.003),
    "ogden, four terms": make("ogden", mu_mpa=[0.1, 0.02, -0.03, 0.2], alpha=[1.3, 4.0, -2.0, 1e-3]),
}


def slope(function: Callable[[Array], Array], c: Array) -> Array:
    """Twice the derivative with respect to the components of `c` (6, 1), last but one axis, by central differences."""
    step, columns = 1e-5, []
    for number in range(6):
        change = np.zeros_like(c)
        change[number] = step
        # Off the diagonal a component stands for two, which a change of it changes both.
        columns.append((2 if number < 3 else 1) * (function(c + change) - function(c - change)) / (2 * step))
    return np.stack(columns, axis=-2)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("law", LAWS)
def test_stress_and_tangent_are_the_derivatives_of_the_energy(law: str, state: str) -> None:
    """Differences err by some 1e-10 of the modulus at steps of 1e-5."""
    material, c = LAWS[law], STATES[state]
    answer = material.isochoric(c, tangent=True)
    atol = 1e-7 * material.shear_modulus_mpa
    np.testing.assert_allclose(
        answer.stress, slope(lambda at: material.isochoric(at, tangent=False).energy, c), atol=atol, rtol=1e-7
    )
    difference = slope(lambda at: material.isochoric(at, tangent=False).stress, c)
    np.testing.assert_allclose(answer.tangent, difference, atol=atol, rtol=1e-7)


@pytest.mark.parametrize("law", LAWS)
def test_undeformed_state_has_the_shear_modulus_and_nothing_else(law: str) -> None:
    material = LAWS[law]
    answer = material.isochoric(STATES["undeformed"], tangent=True)
    assert answer.energy == pytest.approx(0, abs=1e-15)
    np.testing.assert_allclose(answer.stress, 0, atol=1e-15)
    mu = material.shear_modulus_mpa
    wanted = np.diag([2 * mu, 2 * mu, 2 * mu, mu, mu, mu])
    wanted[:3, :3] -= 2 / 3 * mu
    assert answer.tangent is not None
    np.testing.assert_allclose(answer.tangent[..., 0], wanted, atol=1e-14)
    assert material.bulk_modulus_mpa == pytest.approx(2 * mu * 1.49 / (3 * 0.02))


@pytest.mark.parametrize(
    ("ogden", "peer"),
    [
        (make("ogden", mu_mpa=[0.22], alpha=[2.0]), Yeoh(c1_mpa=0.11, c2_mpa=0.0)),
        (make("ogden", mu_mpa=[0.18, -0.04], alpha=[2.0, -2.0]), make("mooney_rivlin", c10_mpa=0.09, c01_mpa=0.02)),
    ],
    ids=["neo-Hooke", "Mooney–Rivlin"],
)
def test_ogden_with_exponents_of_2(ogden: Material, peer: Material) -> None:
    c = np.concatenate(list(STATES.values()), axis=1)
    ours, theirs = (law.isochoric(c, tangent=True) for law in (ogden, peer))
    assert ogden.shear_modulus_mpa == pytest.approx(peer.shear_modulus_mpa)
    for part in ("energy", "stress", "tangent"):
        np.testing.assert_allclose(getattr(ours, part), getattr(theirs, part), atol=1e-13)


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


class TestStability:
    @pytest.mark.parametrize(
        ("law", "fields"),
        [
            ("yeoh", {"c1_mpa": 0.017, "c2_mpa": -0.0002, "c3_mpa": 0.000023}),  # Ecoflex 00-30
            ("yeoh", {"c1_mpa": 0.22766, "c2_mpa": 0.05897, "c3_mpa": -0.0045}),  # Smooth-Sil 950
            ("mooney_rivlin", {"c10_mpa": 0.2, "c01_mpa": -0.01}),
            ("ogden", {"mu_mpa": [-0.000981, 0.0671, 0.00169], "alpha": [-3.848, 0.663, 4.225]}),  # Ecoflex 00-30
        ],
    )
    def test_negative_coefficients_are_taken_where_the_law_is_stable(self, law: str, fields: dict[str, Any]) -> None:
        assert make(law, **fields).shear_modulus_mpa > 0

    def test_softening_is_found_where_the_nominal_stress_has_its_maximum(self) -> None:
        """Equibiaxial nominal stress 2 (λ − λ⁻⁵) (c1 + 2 c2 (Ī₁ − 3)) of a negative c2, on the steps of the check."""
        stretch = np.linspace(1, 2, 41)
        nominal = (stretch - stretch**-5) * (0.11 - 0.02 * (2 * stretch**2 + stretch**-4 - 3))
        peak = stretch[nominal.argmax()]
        with pytest.raises(InputError, match=r"softens: its nominal stress falls in equibiaxial .* stretch of") as told:
            Yeoh(c2_mpa=-0.01)
        assert float(str(told.value).split("stretch of ")[1].split(";")[0]) == pytest.approx(peak, abs=0.026)

    def test_a_mooney_rivlin_solid_with_negative_c10_is_not_elliptic(self) -> None:
        """Shear waves need c10 + c01 λ_k² > 0 for all k: if equibiaxial, λ₃ = λ⁻², up to λ = 2^(1/4) = 1.189."""
        with pytest.raises(InputError, match=r"loses ellipticity in equibiaxial tension at a stretch of 1\.2;"):
            make("mooney_rivlin", c10_mpa=-0.1, c01_mpa=0.2)

    @pytest.mark.parametrize(
        ("law", "fields", "sentence"),
        [
            ("yeoh", {"c1_mpa": 0.0}, r"shear modulus .* is 0 MPa \(c1_mpa=0.0, .*must be above 0"),
            ("mooney_rivlin", {"c01_mpa": -0.2}, r"shear modulus .* is -0.22 MPa \(c10_mpa=0.09, c01_mpa=-0.2\)"),
            ("yeoh", {"c3_mpa": float("nan")}, r"not finite \(.*c3_mpa=nan"),
            ("yeoh", {"poisson": 0.5}, r"material.poisson is 0.5;"),
            ("ogden", {"poisson": -0.1}, r"material.poisson is -0.1;"),
            ("ogden", {"alpha": [2.0]}, r"mu_mpa has 2 values and material.alpha 1:"),
            ("ogden", {"alpha": [2.0, 0.0]}, r"alpha is \[2.0, 0.0\]; an exponent must not be 0"),
        ],
    )
    def test_refuses_what_is_no_solid(self, law: str, fields: dict[str, Any], sentence: str) -> None:
        with pytest.raises(InputError, match=sentence):
            make(law, **fields)
