"""Whether a hyperelastic law stays stable as it is stretched.

Up to a stretch of `STABLE_STRETCH` the nominal stress must rise, and the incompressible solid must stay strongly
elliptic (m·A(n) m > 0 with the acoustic tensor A and every m ⊥ n: J. K. Knowles, E. Sternberg, Journal of Elasticity 8,
1978), in uniaxial and equibiaxial tension, which includes uniaxial compression to 1/4 of the length, and in pure shear.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.invariants import PLACES
from pgdl_lab.mechanics.response import Isochoric

Array = NDArray[np.float64]

STABLE_STRETCH = 2.0
STEPS = 40  # of the stretch
ANGLES = 10  # of the wave's direction, in each of two angles

# Exponents of the principal stretches.
MODES = {
    "uniaxial tension": (1.0, -0.5, -0.5),
    "equibiaxial tension": (1.0, 1.0, -2.0),
    "pure shear": (1.0, 0.0, -1.0),
}


def weakness(isochoric: Callable[[Array], Isochoric]) -> str:
    """What goes wrong first, as the end of a sentence; empty if nothing does.

    Parameters
    ----------
    isochoric
        Answer, with tangent, of an isotropic law to a right Cauchy–Green tensor (6, M, S).
    """
    stretch = np.linspace(1, STABLE_STRETCH, STEPS + 1)
    exponents = 2 * np.array(list(MODES.values())).T[..., None]  # of the principal values of C
    c = np.zeros((6, len(MODES), len(stretch)))
    c[:3] = stretch**exponents
    answer = isochoric(c)
    assert answer.tangent is not None
    faults = {"its nominal stress falls": _falls(stretch, exponents, answer), "loses ellipticity": _waves(c, answer)}
    found = [
        (float(stretch[wrong.argmax()]), f"softens: {what}" if "falls" in what else what, mode)
        for what, table in faults.items()
        for mode, wrong in zip(MODES, table, strict=True)
        if wrong.any()
    ]
    if not found:
        return ""
    at, what, mode = min(found)
    return f"{what} in {mode} at a stretch of {at:.3g}"


def _falls(stretch: Array, exponents: Array, answer: Isochoric) -> NDArray[np.bool_]:
    """Where the second derivative of the energy along each mode (M, S) is not positive."""
    assert answer.tangent is not None
    slope = exponents * stretch ** (exponents - 1)
    curvature = exponents * (exponents - 1) * stretch ** (exponents - 2)
    second = (answer.stress[:3] * curvature).sum(axis=0) / 2
    second += np.einsum("i...,ij...,j...->...", slope, answer.tangent[:3, :3], slope) / 4
    return np.asarray(~(second > 0))


def _waves(c: Array, answer: Isochoric) -> NDArray[np.bool_]:
    """Where some wave (M, S) has no real speed; its directions in one octant stand for all, as C is diagonal."""
    assert answer.tangent is not None
    polar, turn = (angle.ravel() for angle in np.meshgrid(*2 * [np.linspace(0, np.pi / 2, ANGLES)]))
    normal = np.array([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    across = np.array(
        [
            [np.cos(polar) * np.cos(turn), np.cos(polar) * np.sin(turn), -np.sin(polar)],
            [-np.sin(turn), np.cos(turn), np.zeros_like(turn)],
        ]
    )
    stretches = np.sqrt(c[:3])
    pushed = np.einsum("i...,j...,k...,l...->ijkl...", *4 * [stretches]) * answer.tangent[PLACES][:, :, PLACES]
    traction = np.einsum("i...,id->d...", c[:3] * answer.stress[:3], normal**2)
    acoustic = np.einsum("pid,ijkl...,jd,ld,qkd->pqd...", across, pushed, normal, normal, across, optimize=True)
    first, second, mixed = acoustic[0, 0] + traction, acoustic[1, 1] + traction, acoustic[0, 1]
    return np.asarray(~((first > 0) & (first * second > mixed**2)).all(axis=0))
