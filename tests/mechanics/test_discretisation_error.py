"""The way to the finer mesh: what is carried over is exact, and the estimate is near the truth."""

import numpy as np
import pytest
import skfem
from skfem import Mesh

from pgdl_lab.mechanics.discretisation_error import (
    ACCURACY,
    DiscretisationError,
    parents,
    prolonged,
    prolonged_pressure,
    refined,
)
from pgdl_lab.mechanics.elements import ELEMENTS, discretise
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.newton import solve
from pgdl_lab.mechanics.solid import Solid
from tests.fingers import pneunet, tetrahedra


def body(cells: str) -> Mesh:
    mesh = pneunet().mesh(6.0)
    return mesh if cells == "hexahedra" else tetrahedra(mesh)


@pytest.mark.parametrize("cells", ["hexahedra", "tetrahedra"])
def test_named_boundaries_keep_their_area(cells: str) -> None:
    def area(mesh: Mesh, name: str) -> float:
        basis = skfem.FacetBasis(mesh, mesh.elem(), facets=name)
        return float(basis.dx.sum())

    mesh = body(cells)
    fine = refined(mesh)
    assert set(fine.boundaries) == {"clamp", "symmetry", "cavity"}
    for name in mesh.boundaries:
        assert area(fine, name) == pytest.approx(area(mesh, name), rel=1e-12)
    assert (fine.p[0, fine.facets[:, fine.boundaries["clamp"]]] == 0).all()


@pytest.mark.parametrize("cells", ["hexahedra", "tetrahedra"])
def test_parts_lie_in_their_whole(cells: str) -> None:
    mesh = body(cells)
    fine = refined(mesh)
    local = mesh.mapping().invF(fine.p[:, fine.t].mean(axis=1)[:, :, None], tind=parents(mesh, fine))
    assert local.min() > 0
    assert (local.max() if cells == "hexahedra" else local.sum(axis=0).max()) < 1


@pytest.mark.parametrize("kind", sorted(ELEMENTS))
def test_quadratic_displacement_and_its_pressure_are_carried_over(kind: str) -> None:
    mesh = body(ELEMENTS[kind].cells)
    coarse, fine = (discretise(each, ELEMENTS[kind]) for each in (mesh, refined(mesh)))

    def field(x: np.ndarray) -> np.ndarray:
        return 1e-4 * np.stack([x[:, 0] * x[:, 2], x[:, 1] ** 2 - x[:, 0], 3 * x[:, 2] ** 2], axis=1)

    found = prolonged(coarse, fine, field(coarse.positions))
    np.testing.assert_allclose(found, field(fine.positions), atol=1e-12)
    stretch = np.array([1.01, 0.995, 0.99]) - 1
    pressure = prolonged_pressure(Solid(coarse, Yeoh()), fine, stretch * coarse.positions)
    np.testing.assert_allclose(pressure, Yeoh().bulk_modulus_mpa * (np.prod(1 + stretch) - 1), rtol=1e-9)


def test_estimate_is_near_the_truth() -> None:
    finger = pneunet()
    model = Model(finger, 6.0, "hex27_p1")
    history = model.load(np.array([finger.max_kpa]), 1e-6, 1e-3)
    estimate = model.discretisation_error(history)
    assert estimate is not None

    fine = model.equilibrium_on(refined(model.mesh))
    displacement, solver = np.zeros(fine.free.shape), symmetric_solver()
    for kpa in (0.0, 10.0, finger.max_kpa):
        displacement = solve(fine, solver, displacement, model.amplitudes(kpa), 1e-6).displacement
    positions = fine.solid.discretisation.positions
    start = prolonged(model.discretisation, fine.solid.discretisation, history.branch.displacements[-1])
    truth = DiscretisationError.of(positions, start, displacement - start, finger.max_kpa)
    assert estimate.tip_mm == pytest.approx(truth.tip_mm, rel=ACCURACY)
    assert estimate.largest_mm == pytest.approx(truth.largest_mm, rel=ACCURACY)
    assert estimate.kpa == finger.max_kpa


def test_change_of_the_end_and_of_the_rest_by_hand() -> None:
    """Five nodes from x = −90 to 10 mm, two of them at the end; lengths are 3-4-5 and 5-12-13."""
    x = np.array([-90.0, 0.0, 9.999, 10.0, 10.0 - 5e-5])
    positions = np.stack([x, np.zeros(5), np.zeros(5)], axis=1)
    displacement = np.array([[0, 0, 90], [0, 0, 80], [0, 0, 70], [3, 0, 4], [0, 5, -12]], dtype=float)
    change = 0.1 * np.array([[1, 0, 0], [0, 8, 15], [20, 0, 0], [0, 3, 4], [-2, 0, 0]], dtype=float)
    found = DiscretisationError.of(positions, displacement, change, 7.0)
    assert found.kpa == 7.0
    assert found.tip_mm == pytest.approx(0.5)
    assert found.tip_percent == pytest.approx(100 * 0.5 / 13)
    assert found.largest_mm == pytest.approx(2.0)


@pytest.mark.parametrize("kind", sorted(ELEMENTS))
def test_pressure_that_grows_along_the_body_is_carried_over(kind: str) -> None:
    """u_x = a x²/2 makes J − 1 = a x; elements of one pressure each have its mean, K a times the x of their middle."""
    mesh = body(ELEMENTS[kind].cells)
    coarse, fine = (discretise(each, ELEMENTS[kind]) for each in (mesh, refined(mesh)))
    slope = 1e-3
    displacement = np.insert(np.zeros((len(coarse.positions), 2)), 0, slope / 2 * coarse.positions[:, 0] ** 2, axis=1)
    found = prolonged_pressure(Solid(coarse, Yeoh()), fine, displacement) / Yeoh().bulk_modulus_mpa
    x = np.asarray(fine.basis.global_coordinates())[0]
    if kind.endswith("p0"):
        x = np.broadcast_to(mesh.p[0, mesh.t].mean(axis=0)[parents(mesh, fine.basis.mesh)][:, None], x.shape)
    np.testing.assert_allclose(found, slope * x, atol=1e-9)
