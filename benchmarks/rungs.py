"""The cheap models beside the solid: error and time of `fem=rod` and both states of `fem=section`.

    python benchmarks/rungs.py

The reference is `fem=solid` with its default element on 3 mm; its snapshots are taken from runs/snapshots if they are
there, with the time that they took when they were made. The others are computed here, each once before the time is
taken. A tip is the end of the base line; per cent are of its displacement.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.common import parsed, parser, print_load, show, table
from benchmarks.scenes import scene, simulated
from pgdl_lab.core import registry
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.mechanics.fem import Fem

FINGERS = ("pneunet", "pneunet_reference", "joints", "bellows")
RUNGS: dict[str, tuple[str, dict[str, Any]]] = {
    "rod": ("rod", {}),
    "section, plane strain": ("section", {"state": "plane_strain"}),
    "section, plane stress": ("section", {"state": "plane_stress"}),
}


@dataclass(frozen=True)
class Error:
    """Distance of a model from the solid at one pressure [mm], and the displacement of the tip [mm]."""

    tip_mm: float
    rms_mm: float
    moved_mm: float

    @classmethod
    def of(cls, snapshots: Dataset, reference: Dataset, number: int) -> "Error":
        """At snapshot `number`."""
        tip = reference.domain.base[-1]
        distance = np.linalg.norm(snapshots.displacements[number] - reference.displacements[number], axis=1)
        moved = np.linalg.norm(reference.displacements[number, tip])
        return cls(float(distance[tip]), float(np.sqrt((distance**2).mean())), float(moved))


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("fingers", nargs="*", default=FINGERS)
    given = parsed(arguments, fingers=["pneunet"])
    headings = ("finger", "model", "kPa", "tip (mm)", "of the way", "rms (mm)", "time (s)", "solid / model")
    shown = table("Cheap models against the solid, at half and full pressure", headings, left=2)
    for name in given.fingers:
        made = scene(name, quick=given.quick)
        reference, observation = simulated(made), made.observation
        for rung, (plugin, fields) in RUNGS.items():
            fem: Fem = registry.plugin("fem", plugin)(**fields)
            fem.simulate(made.finger, observation)
            snapshots = fem.simulate(made.finger, observation)
            seconds = snapshots.provenance["seconds"]
            ratio = reference.provenance["seconds"] / seconds
            half, full = observation.snapshots // 2 - 1, observation.snapshots - 1
            for number, rest in ((half, ("", "")), (full, (f"{seconds:.2f}", f"{ratio:.0f}×"))):
                error, kpa = Error.of(snapshots, reference, number), reference.pressures_kpa[number]
                share = f"{error.tip_mm / error.moved_mm:.1%}"
                shown.add_row(name, rung, f"{kpa:g}", f"{error.tip_mm:.2f}", share, f"{error.rms_mm:.2f}", *rest)
        shown.add_section()
    show(shown)
    print_load()


if __name__ == "__main__":
    main()
