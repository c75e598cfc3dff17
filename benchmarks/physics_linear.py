"""Physics as the penalty of the linear model: plane-stress balance beside pure smoothness, on few points.

    python benchmarks/physics_linear.py

`u` is hat functions on the body times polynomials in the pressure, found by one least-squares solve. Its prior is what
`model=pod` learns, thin-plate smoothness, weighted with α². To it is added β² times the squared forces that linear
plane stress leaves out of balance inside the face, scaled to the same mean square over the coefficients. The best α and
β are chosen by the error on unseen points: no weight found without them can do better. The same with the forces of a
membrane (the Laplacian of each component, no elasticity) tells what is physics in the gain and what any second penalty
would give.
"""

import itertools
from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from benchmarks import common
from benchmarks.scenes import scene, simulated
from pgdl_lab.core import registry
from pgdl_lab.learning.data import Samples
from pgdl_lab.learning.polynomials import basis_of
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.separable import RIDGE, SeparableRegression
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.surrogate.triangulation import Triangulation

Floats = NDArray[np.float64]
Errors = dict[tuple[str, float, str, float, float], list[tuple[float, float]]]
NAMES = ("plane stress", "membrane")

DEGREE, ROUNDS, DRAWS, POINTS = 6, 4, 16, 1200
SHARES = (0.05, 0.01, 0.002)
ALPHAS = (0.3, 1.0, 3.0)
BETAS = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)


def unbalanced(body: Triangulation, lame_mpa: float, shear_mpa: float, *, membrane: bool) -> sp.csr_matrix:
    """(2 I, 2 N): forces that linear plane stress leaves out of balance at I inner nodes, by the root of their area.

    Linear triangles; unknowns are u_x at all nodes, then u_z.
    """
    plane = 2 * lame_mpa * shear_mpa / (lame_mpa + 2 * shear_mpa)  # λ with σ_yy = 0
    corners, triangles, count = body.points_mm[body.simplices], body.simplices, len(body.points_mm)
    edges = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    signed = (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2
    grad = np.stack([-edges[..., 1], edges[..., 0]], axis=-1) / (2 * signed[:, None, None])
    area = np.abs(signed)
    local = np.zeros((len(area), 3, 2, 3, 2))
    if not membrane:
        local += np.einsum("t,tai,tbj->taibj", plane * area, grad, grad)
        local += np.einsum("t,taj,tbi->taibj", shear_mpa * area, grad, grad)
    local += np.einsum("t,tak,tbk,ij->taibj", shear_mpa * area, grad, grad, np.eye(2))
    number = triangles[:, :, None] + count * np.arange(2)
    row = np.broadcast_to(number[:, :, :, None, None], local.shape)
    column = np.broadcast_to(number[:, None, None], local.shape)
    whole = sp.csr_matrix((local.ravel(), (row.ravel(), column.ravel())), shape=(2 * count, 2 * count))
    ends = np.sort(np.concatenate([np.roll(triangles, c, axis=1)[:, :2] for c in range(3)]), axis=1)
    pairs, uses = np.unique(ends, axis=0, return_counts=True)
    inner = np.setdiff1d(np.arange(count), pairs[uses == 1])
    share = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), minlength=count)[inner]
    rows = np.concatenate([inner, inner + count])
    return sp.diags(np.tile(share**-0.5, 2)) @ whole[rows]


def main() -> None:
    """Print the table."""
    arguments = common.parser(__doc__)
    arguments.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    arguments.add_argument("--shares", type=float, nargs="+", default=SHARES, help="of the points that are trained on")
    given = common.parsed(arguments, seeds=[0], shares=[0.05])
    points = () if given.quick else (f"observation.points={POINTS}",)
    made = scene("pneunet", "fem.estimate_error=false", *points, quick=given.quick)
    snapshots = simulated(made)
    face = Scene.of(made.finger, snapshots)
    body = Triangulation(face.domain.points_mm, face.domain.cells)
    kpa = snapshots.pressures_kpa
    penalties = {
        name: unbalanced(body, face.lame_mpa, face.shear_modulus_mpa, membrane=name == "membrane") for name in NAMES
    }
    found: Errors = {}
    for split, share, seed in itertools.product(("random", "extrapolate"), given.shares, given.seeds):
        rule = registry.plugin("split", split)(points=round(share * snapshots.displacements[..., 0].size))
        train = rule.train_points(snapshots, seed)
        samples = Samples.of(snapshots, train)
        regression = SeparableRegression(body, face.domain.clamp, samples, basis_of(samples.cases, DEGREE))
        rng, prior = np.random.default_rng(seed), regression.first_prior()
        for _ in range(ROUNDS):
            prior = regression.learnt(regression.posterior(prior, DRAWS, rng))
        regression.close()
        for name, alpha, beta in itertools.product(NAMES, ALPHAS, BETAS):
            if beta == 0 and name != NAMES[0]:
                continue
            field = solve(regression, prior.amplitudes, prior.noise_mm, penalties[name], alpha, beta, kpa)
            square = ((field - snapshots.displacements) ** 2).sum(axis=2)
            square.flat[train] = np.nan
            errors = tuple(float(np.sqrt(np.nanmean(square[which]))) for which in (kpa <= 44, kpa > 44))
            found.setdefault((split, share, name, alpha, beta), []).append((errors[0], errors[1]))
    show(found, given.shares)


def solve(
    regression: SeparableRegression, amplitudes: Floats, noise_mm: float, physics: sp.csr_matrix,
    alpha: float, beta: float, kpa: Floats,
) -> Floats:  # fmt: skip
    """The field (P, N, 2) [mm] under both penalties."""
    order, count, free = len(regression.orders), regression.nodes, regression.free
    design = regression._products(regression.hats, regression.polynomials @ amplitudes / noise_mm)
    kinks = sp.kron(regression.kinks, sp.identity(order), format="csr")
    smooth = (design.T @ design + alpha**2 * (kinks.T @ kinks)).tocsr()
    ours = physics[:, np.concatenate([free, free + count])]
    ours = ours * np.sqrt(2 * (regression.kinks.data**2).sum() / (ours.data**2).sum())
    forces = sp.kron(beta * ours, sp.identity(order), format="csr")
    normal = sp.block_diag([smooth, smooth], format="csr") + forces.T @ forces
    normal = normal + RIDGE * sp.identity(normal.shape[0])
    right = (design.T @ (regression.samples.displacements_mm / noise_mm)).T.ravel()
    solver = symmetric_solver()
    solver.factorise(sp.triu(normal, format="csr"))
    solution = solver.solve(right[:, None])
    solver.close()
    nodal = np.zeros((2, count, order))
    nodal[:, free] = solution.reshape(2, len(free), order)
    high = regression.samples.pressures_kpa.max()
    polynomials = np.polynomial.chebyshev.chebvander(2 * kpa / high - 1, len(regression.orders) - 1) @ amplitudes
    return np.einsum("pk,ink->pni", polynomials, nodal)


def show(found: Errors, shares: Iterable[float]) -> None:
    """Best smoothness alone beside best smoothness with either penalty."""
    title = "RMS error in mm, mean over seeds (least … greatest), best α and β each"
    table = common.table(title, ("split", "points", "judged", "smoothness alone", *NAMES), left=0)
    for split, share, judged in itertools.product(("random", "extrapolate"), shares, (0, 1)):

        def errors(name: str, beta: float, at: tuple[str, float, int] = (split, share, judged)) -> Floats:
            tried = [[pair[at[2]] for pair in found[at[0], at[1], name, alpha, beta]] for alpha in ALPHAS]
            return np.array(min(tried, key=np.mean))

        alone = errors(NAMES[0], 0.0)
        cells = [common.spread(alone)]
        for name in NAMES:
            tried = {beta: errors(name, beta) for beta in BETAS[1:]}
            beta, least = min(tried.items(), key=lambda pair: pair[1].mean())
            ratio = least / alone
            cells.append(f"×{common.spread(ratio, form='.2f')}, β = {beta:g}")
        table.add_row(split, f"{share:.1%}", ("up to 44 kPa", "above 44 kPa")[judged], *cells)
    common.show(table)


if __name__ == "__main__":
    main()
