"""Time of one Newton iteration, split into its parts, beside scikit-fem's general assembly of the same matrix.

    python benchmarks/newton_iteration.py

The finger is `pneunet` with elements of 3 mm at a bent state. Each figure is the median of repeated runs in this one
process; the matrices of both assemblies are compared before any time is reported. `search` is one trial of the line
search: energy and forces alone.
"""

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import NDArray
from skfem.helpers import ddot

from benchmarks.common import parsed, parser, show, table
from benchmarks.scenes import scene
from pgdl_lab.mechanics.elements import ELEMENTS
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.material import FirstInvariantMaterial

LOAD = {"weight": 1.0}


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Median wall time of `work` [s], after one call that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return median(times)


def general_assembly(
    model: Model, element: str, finger: Finger, displacement: NDArray[np.float64]
) -> tuple[Callable[[], sp.csr_matrix], NDArray[np.int64]]:
    """The stiffness of the solid by scikit-fem's forms: a fourth-order tensor per quadrature point, then one form.

    Returns
    -------
    assemble
        Function that assembles the matrix at `displacement` (N, 3) [mm].
    order
        Its row for each of our degrees of freedom.
    """
    kind = ELEMENTS[element]
    basis = skfem.Basis(model.mesh, skfem.ElementVector(getattr(skfem, kind.shape)()), intorder=kind.quadrature_order)
    order = np.empty(basis.N, dtype=np.int64)
    scalar = model.discretisation.nodes.T
    for component in range(3):
        order[3 * scalar + component] = basis.element_dofs[component::3]
    vector = np.empty(basis.N)
    vector[order] = displacement.ravel()
    material, identity = finger.material, np.eye(3)[:, :, None, None]
    assert isinstance(material, FirstInvariantMaterial)

    # scikit-fem hands over fields of its own making, which neither it nor its decorator has types for.
    @skfem.BilinearForm
    def stiffness(u, v, w):  # type: ignore[no-untyped-def]
        return ddot(np.einsum("ijkl...,kl...->ij...", w["tangent"], u.grad), v.grad)

    def assemble() -> sp.csr_matrix:
        f = np.asarray(basis.interpolate(vector).grad) + identity
        inverse = np.linalg.inv(f.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
        h, j = inverse.transpose(1, 0, 2, 3), np.linalg.det(f.transpose(2, 3, 0, 1))
        shrink = j ** (-2 / 3)
        invariant = shrink * np.einsum("ij...,ij...->...", f, f)
        first, second = material.derivatives(invariant)
        along = 2 * shrink * f - 2 / 3 * invariant * h  # derivative of the invariant
        pressure = material.bulk_modulus_mpa * (j - 1)

        def outer(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
            return np.einsum("ij...,kl...->ijkl...", a, b)

        exchanged = np.einsum("il...,kj...->ijkl...", h, h)
        tangent = (
            2 * shrink * first * np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))[..., None, None]
            - 4 / 3 * shrink * first * (outer(f, h) + outer(h, f))
            + (4 / 9 * invariant * first + pressure * j + material.bulk_modulus_mpa * j**2) * outer(h, h)
            + (2 / 3 * invariant * first - pressure * j) * exchanged
            + second * outer(along, along)
        )
        matrix: sp.csr_matrix = stiffness.assemble(basis, tangent=tangent)
        return matrix

    return assemble, order


def measure(element: str, finger: Finger, edge_mm: float, repeats: int) -> list[str]:
    """One row of the table."""
    model = Model(finger, edge_mm, element)
    equilibrium, solver = model.equilibrium, model.solver
    angle = 0.5 * model.discretisation.positions[:, [0]] / 114
    bent = np.hstack([-10 * angle**2, 0 * angle, -30 * angle**2]) * equilibrium.free
    balance = equilibrium.balance(bent, LOAD, stiffness=True)
    assert balance.stiffness is not None
    upper, residual = balance.stiffness, balance.forces[equilibrium.free]
    parts = [
        seconds(lambda: equilibrium.balance(bent, LOAD, stiffness=True), repeats),
        seconds(lambda: solver.factorise(upper), repeats),
        seconds(lambda: solver.solve(residual), repeats),
        seconds(lambda: equilibrium.balance(bent, LOAD, stiffness=False), repeats),
    ]
    solver.close()
    peer = ["–", "–"]
    if ELEMENTS[element].pressure_modes is None:
        assemble, order = general_assembly(model, element, finger, bent)
        free = order[equilibrium.free.ravel()]
        ours = upper + sp.triu(upper, 1).T
        difference = np.abs(assemble()[free][:, free] - ours).max() / np.abs(ours).max()
        assert difference < 1e-10, f"the two assemblies differ by {difference:.1e}"
        general = seconds(assemble, min(repeats, 3))
        peer = [f"{1e3 * general:.0f}", f"{general / parts[0]:.0f}×"]
    return [element, f"{equilibrium.free.sum():,}", *[f"{1e3 * part:.1f}" for part in parts], *peer]


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--edge-mm", type=float, default=3.0)
    arguments.add_argument("--repeats", type=int, default=15)
    given = parsed(arguments, edge_mm=6.0, repeats=2)
    finger = scene("pneunet_reference", quick=given.quick).finger
    title = f"One Newton iteration of pneunet_reference, elements of {given.edge_mm:g} mm, median milliseconds"
    headings = ("element", "unknowns", "assembly", "factors", "solve", "search", "skfem forms", "ratio")
    shown = table(title, headings, left=0)
    for element in ("hex20", "hex27", "hex27_p1"):
        shown.add_row(*measure(element, finger, given.edge_mm, given.repeats))
    show(shown)


if __name__ == "__main__":
    main()
