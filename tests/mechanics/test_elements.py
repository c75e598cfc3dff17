"""Element kernels: exact derivatives, patch test, homogeneous deformation in closed form."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshHex, MeshTet

from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, discretise
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.solid import InvertedElement, Solid

KINDS = sorted(ELEMENTS)


def distorted(kind: str) -> Discretisation:
    """Twenty-seven hexahedra, or six times as many tetrahedra, whose inner corners are moved."""
    shape = MeshHex if ELEMENTS[kind].cells == "hexahedra" else MeshTet
    mesh = shape.init_tensor(*3 * [np.linspace(0, 3, 4)])
    inner = ((mesh.p > 0) & (mesh.p < 3)).all(axis=0)
    corners = mesh.p.copy()
    corners[:, inner] += np.random.default_rng(0).uniform(-0.25, 0.25, (3, inner.sum()))
    return discretise(shape(corners, mesh.t), ELEMENTS[kind])


def nodal(discretisation: Discretisation, forces: NDArray[np.float64]) -> NDArray[np.float64]:
    total = np.zeros_like(discretisation.positions)
    np.add.at(total, discretisation.nodes, forces.reshape(*discretisation.nodes.shape, 3))
    return total


@pytest.mark.parametrize("kind", KINDS)
def test_pressure_modes_are_orthonormal(kind: str) -> None:
    mesh = distorted(kind)
    gram = np.einsum("emq,enq,eq->emn", mesh.modes, mesh.modes, mesh.weights)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(gram.shape[1]), gram.shape), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_forces_and_stiffness_against_differences(kind: str) -> None:
    mesh = distorted(kind)
    solid, random, step = Solid(mesh, Yeoh()), np.random.default_rng(1), 1e-6
    at, direction = 0.01 * random.normal(size=mesh.positions.shape), random.normal(size=mesh.positions.shape)
    here = solid.response(at, stiffness=True)
    above, below = (solid.response(at + s * direction, stiffness=False) for s in (step, -step))
    local = direction[mesh.nodes].reshape(here.forces.shape)
    assert (above.energy - below.energy) / (2 * step) == pytest.approx(float((here.forces * local).sum()), rel=1e-7)
    assert here.stiffness is not None
    change = (above.forces - below.forces) / (2 * step)
    np.testing.assert_allclose((here.stiffness @ local[..., None])[..., 0], change, atol=1e-6 * np.abs(change).max())
    np.testing.assert_allclose(here.stiffness, here.stiffness.transpose(0, 2, 1), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_patch_of_finite_homogeneous_strain(kind: str) -> None:
    """A linear displacement is in equilibrium inside, whatever the shape of the elements."""
    mesh = distorted(kind)
    gradient = np.array([[0.3, 0.2, -0.1], [0.0, -0.1, 0.25], [0.1, 0.0, 0.05]])
    forces = nodal(mesh, Solid(mesh, Yeoh()).response(mesh.positions @ gradient.T, stiffness=False).forces)
    inside = ((mesh.positions > 1e-9) & (mesh.positions < 3 - 1e-9)).all(axis=1)
    assert inside.sum() > 0
    np.testing.assert_allclose(forces[inside], 0, atol=1e-12 * np.abs(forces).max() + 1e-13)


@pytest.mark.parametrize(("stretch", "nominal"), [(1.1, 0.060799), (1.25, 0.142130), (1.5, 0.281481), (2.0, 0.665000)])
def test_uniaxial_tension_in_closed_form(stretch: float, nominal: float) -> None:
    """Nominal stress 2 (λ − λ⁻²) (c1 + 2 c2 (I₁ − 3)) of the incompressible solid [MPa];
    the pressure follows from stress-free sides."""
    mesh, material = distorted("hex27_p1"), Yeoh(poisson=0.499999)
    lateral = stretch**-0.5
    invariant = stretch**2 + 2 / stretch
    deviator = (stretch**2 - 1 / stretch) / 3  # of F Fᵀ, along y: b_yy − I₁/3 = −deviator
    slope = material.c1_mpa + 2 * material.c2_mpa * (invariant - 3)
    assert 2 * (stretch - stretch**-2) * slope == pytest.approx(nominal, rel=1e-5)
    pressure = 2 * slope * deviator  # tension that frees the sides
    swelling = (1 + pressure / material.bulk_modulus_mpa) ** (1 / 3)
    gradient = np.diag([stretch, lateral, lateral]) * swelling - np.eye(3)
    forces = nodal(mesh, Solid(mesh, material).response(mesh.positions @ gradient.T, stiffness=False).forces)
    area = 9.0
    pull = forces[np.isclose(mesh.positions[:, 0], 3), 0].sum() / area
    side = forces[np.isclose(mesh.positions[:, 1], 3), 1].sum() / area
    assert pull == pytest.approx(nominal, rel=1e-4)
    assert side == pytest.approx(0, abs=1e-5)


def test_inverted_element_is_noticed() -> None:
    mesh = distorted("hex20")
    mirrored: Any = -2 * mesh.positions * [1, 0, 0]
    with pytest.raises(InvertedElement):
        Solid(mesh, Yeoh()).response(mirrored, stiffness=False)
