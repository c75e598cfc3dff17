import numpy as np
import pytest
from numpy.typing import NDArray

from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.elements import ELEMENTS, Discretisation, discretise
from tests.fingers import pneunet, tetrahedra


@pytest.fixture(scope="module", params=["hex20", "hex27_p1", "tet10_p0", "tet15_p1"])
def mesh(request: pytest.FixtureRequest) -> Discretisation:
    mesh = pneunet().mesh(6.0)
    return discretise(mesh if request.param.startswith("hex") else tetrahedra(mesh), ELEMENTS[request.param])


def in_plane(mesh: Discretisation, field: NDArray[np.float64]) -> NDArray[np.float64]:
    """The field with what leaves the plane of symmetry taken out."""
    return field * np.where(np.isclose(mesh.positions[:, [1]], 0), [1, 0, 1], 1)


def test_volume_of_chambers_and_channel(mesh: Discretisation) -> None:
    undeformed = np.zeros_like(mesh.positions)
    assert Cavity(mesh.basis).volume_mm3(undeformed) == pytest.approx((2 * 4.5 * 11 + 7 * 2) * 5)


def test_volume_follows_an_affine_map(mesh: Discretisation) -> None:
    gradient = np.array([[0.2, 0.0, 0.3], [0.0, -0.1, 0.0], [-0.2, 0.0, 0.1]])
    cavity = Cavity(mesh.basis)
    before = cavity.volume_mm3(np.zeros_like(mesh.positions))
    after = cavity.volume_mm3(mesh.positions @ gradient.T + [5.0, 0.0, -3.0])
    assert after == pytest.approx(before * np.linalg.det(np.eye(3) + gradient))


def test_derivatives_against_differences(mesh: Discretisation) -> None:
    cavity, random, step = Cavity(mesh.basis), np.random.default_rng(0), 1e-6
    at = 0.1 * random.normal(size=mesh.positions.shape)
    direction = random.normal(size=mesh.positions.shape)
    here = cavity.response(at, stiffness=True)
    above, below = (cavity.response(at + s * direction, stiffness=True) for s in (step, -step))
    local = direction[cavity.nodes].reshape(here.forces.shape)
    assert (above.energy - below.energy) / (2 * step) == pytest.approx(float((here.forces * local).sum()), rel=1e-7)
    change = (above.forces - below.forces) / (2 * step)
    np.testing.assert_allclose((here.stiffness @ local[..., None])[..., 0], change, atol=1e-7 * np.abs(change).max())
    np.testing.assert_allclose(here.stiffness, here.stiffness.transpose(0, 2, 1), atol=1e-12)


def test_load_is_pressure_times_normal(mesh: Discretisation) -> None:
    """The work on any field that keeps the plane of symmetry is that of a follower pressure, −∫ v · n da.

    The push on the walls does that work on other fields too, which move the rim of an opening.
    The classical form integrates the deformed normal over each facet, the code differentiates a volume; they differ by
    terms on the edges of the walls that must cancel, also where the cavity is cut by the plane of symmetry.
    """
    import skfem

    random = np.random.default_rng(2)
    displacement = in_plane(mesh, 0.1 * random.normal(size=mesh.positions.shape))
    anything = random.normal(size=mesh.positions.shape)
    walls = skfem.FacetBasis(mesh.basis.mesh, mesh.basis.elem, facets="cavity", intorder=8)
    gradient = np.stack([walls.interpolate(displacement[:, i]).grad for i in range(3)]) + np.eye(3)[:, :, None, None]
    normal = np.asarray(walls.normals)
    inverse = np.linalg.inv(gradient.transpose(2, 3, 0, 1))
    deformed = np.linalg.det(gradient.transpose(2, 3, 0, 1)) * np.einsum("wqji,jwq->iwq", inverse, normal)  # Nanson
    cavity = Cavity(mesh.basis)
    volume, push = cavity.response(displacement, stiffness=False).forces, cavity.push(displacement)
    for forces, field in ((-volume, in_plane(mesh, anything)), (push, anything)):
        moved = np.stack([np.asarray(walls.interpolate(field[:, i])) for i in range(3)])
        work = (forces.reshape(*cavity.nodes.shape, 3) * field[cavity.nodes]).sum()
        assert work == pytest.approx(-(moved * deformed * walls.dx).sum(), rel=1e-6)
