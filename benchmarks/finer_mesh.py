"""Whether a surrogate is good only against the mesh that its data were made on.

    python benchmarks/finer_mesh.py [--finger pneunet] [--edge 1.5] [--model hybrid]

Trained on data of the default mesh, a surrogate is judged against it and against a finer one, observed at the same
points; and the other way round. Where both errors against the other mesh equal the distance of the two meshes, the
surrogate adds nothing to the discretisation error; where that trained on the finer data errs as little against them as
the other against its own, the small errors do not come from the coarse mesh's functions. Random split, unseen points.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.common import parsed, parser
from benchmarks.scenes import fitted, scene, simulated


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--finger", default="pneunet")
    arguments.add_argument("--edge", type=float, default=1.5, help="edges of the finer mesh [mm]")
    arguments.add_argument("--model", default="hybrid")
    given = parsed(arguments, edge=3.0)
    made = scene(given.finger, f"model={given.model}", quick=given.quick)
    solid: Any = made.fem
    meshes = {
        f"{fem.edge_mm:g} mm": simulated(replace(made, fem=fem))
        for fem in (solid, replace(solid, edge_mm=given.edge, estimate_error=False))
    }
    coarse, fine = meshes.values()
    if not np.array_equal(coarse.domain.points_mm, fine.domain.points_mm):
        raise SystemExit("The meshes are not observed at the same points: choose another --edge.")
    train = made.split.train_points(coarse, 0)

    def mse(difference: np.ndarray) -> str:
        x, z = (np.delete(difference.reshape(-1, 2), train, axis=0) ** 2).mean(axis=0)
        return f"{x:.2e}, {z:.2e}"

    print(f"{given.finger}, model {given.model}, random split: mean squared error x, z [mm²] over unseen points")
    print(f"{'':<24}" + "".join(f"{f'against {name}':>24}" for name in meshes))
    print(f"{'the meshes themselves':<24}{'–':>24}{mse(coarse.displacements - fine.displacements):>24}")
    for name, snapshots in meshes.items():
        surrogate, _ = fitted(made, snapshots, train)
        predicted = surrogate.predict(coarse.domain.points_mm, coarse.pressures_kpa)
        errors = (mse(predicted - other.displacements) for other in meshes.values())
        print(f"{f'trained on {name}':<24}" + "".join(f"{error:>24}" for error in errors), flush=True)


if __name__ == "__main__":
    main()
