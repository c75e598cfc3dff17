"""Element kernels: exact derivatives, patch test, homogeneous deformation in closed form."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshHex, MeshTet

from pgdl_lab.core import registry
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, discretise
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.solid import InvertedElement, Solid

registry.discover()
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


@pytest.mark.parametrize("law", ["yeoh", "mooney_rivlin"])  # of the first invariant, for which there is a shorter way
@pytest.mark.parametrize("kind", KINDS)
def test_forces_and_stiffness_against_differences(kind: str, law: str) -> None:
    mesh = distorted(kind)
    solid, random, step = Solid(mesh, registry.plugin("material", law)()), np.random.default_rng(1), 1e-6
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
def test_pressure_of_its_own(kind: str) -> None:
    """What goes with homogeneous strain is K (det F − 1); another one does the work p dV, and has its stiffness."""
    mesh, material = distorted(kind), Yeoh()
    solid, random, step, ones = Solid(mesh, material), np.random.default_rng(1), 1e-5, np.ones_like(mesh.weights)
    gradient = np.array([[0.3, 0.2, -0.1], [0.0, -0.1, 0.25], [0.1, 0.0, 0.05]])
    dilatation = np.linalg.det(np.eye(3) + gradient) - 1
    at, direction = mesh.positions @ gradient.T, random.normal(size=mesh.positions.shape)
    known = material.bulk_modulus_mpa * dilatation * ones
    np.testing.assert_allclose(solid.pressure(at), known, rtol=1e-9)
    whole, given = (each.response(at, stiffness=True) for each in (solid, solid.at_pressure(known)))
    np.testing.assert_allclose(given.forces, whole.forces, atol=1e-12)

    def volume(displacement: NDArray[np.float64]) -> float:
        f = np.einsum("eai,eajq->eqij", displacement[mesh.nodes], mesh.gradients) + np.eye(3)
        return float((mesh.weights * np.linalg.det(f)).sum())

    more = solid.at_pressure(known + 0.1 * ones).response(at, stiffness=True)
    local = direction[mesh.nodes].reshape(more.forces.shape)
    before, here, after = (volume(at + s * direction) for s in (-step, 0.0, step))
    assert ((more.forces - given.forces) * local).sum() == pytest.approx(0.1 * (after - before) / (2 * step), rel=1e-6)
    assert more.stiffness is not None and given.stiffness is not None
    bent = np.einsum("ei,eij,ej->", local, more.stiffness - given.stiffness, local)
    assert bent == pytest.approx(0.1 * (after - 2 * here + before) / step**2, rel=1e-3)


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
