"""How far off `fem=rod` is on short fingers, at loads so small that walls neither stiffen nor swell.

    python benchmarks/short_fingers.py

The reference is `fem=solid` with its default element on 3 mm. Per cent are of what the end of the base line moves in
the solid: under a little pressure without weight, and under a little weight without pressure.
"""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.common import parsed, parser, show, table
from pgdl_lab.core import registry
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.segments import cuts
from pgdl_lab.running.composing import experiment

LOADS: dict[str, tuple[str, str]] = {
    "pressure": ("finger.gravity_m_s2=[0.0,0.0]", "finger.max_kpa=0.1"),
    "weight": ("finger.gravity_m_s2=[0.0,-0.01]", "finger.max_kpa=1e-6"),
}


def fingers() -> Iterator[list[str]]:
    """What is typed for each finger."""
    for name in ("pneunet", "pneunet_reference"):
        yield from ([f"finger={name}", f"finger.chambers={chambers}"] for chambers in (1, 2, 3, 4, 6, 10))
    for joints, chambers in ((1, 1), (1, 2), (2, 2), (3, 3)):
        yield ["finger=joints", f"finger.joints={joints}", f"finger.chambers={chambers}"]
    for folds in (1, 2, 3, 4):
        yield ["finger=bellows", f"finger.folds={folds}"]


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--edge-mm", type=float, default=3.0, help="edges of the solid's mesh")
    arguments.add_argument("--most", type=int, help="only the first so many fingers")
    given = parsed(arguments, edge_mm=6.0, most=2)
    registry.discover()
    solid: Fem = registry.plugin("fem", "solid")(edge_mm=given.edge_mm, estimate_error=False)
    rod: Fem = registry.plugin("fem", "rod")()
    shown = table("fem=rod against the solid at small loads", ("finger", "segments", *LOADS), left=2 + len(LOADS))
    for typed in itertools.islice(fingers(), given.most):
        cells = []
        for load in LOADS.values():
            finger: Any = experiment([*typed, *load]).finger
            exact, found = (
                snapshots.displacements[0, snapshots.domain.base[-1]]
                for snapshots in (fem.simulate(finger, Observation(1, 800)) for fem in (solid, rod))
            )
            cells.append(f"{np.linalg.norm(found - exact) / np.linalg.norm(exact):.1%}")
        shown.add_row(" ".join(typed), str(len(cuts(finger.profile())) - 1), *cells)
    show(shown)


if __name__ == "__main__":
    main()
