"""Small fingers whose simulation takes a second."""

from dataclasses import replace
from typing import Any

from pgdl_lab import registry
from pgdl_lab.fem import Fem
from pgdl_lab.finger import Finger
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.snapshots import Observation

registry.discover()

OBSERVATION = Observation(snapshots=10, points=800)


def pneunet(**fields: Any) -> Finger:
    """A finger of two chambers up to 20 kPa, or with other `fields`."""
    finger: Finger = registry.plugin("finger", "pneunet")(**{"chambers": 2, "max_kpa": 20.0, **fields})
    return finger


def solid(**fields: Any) -> Fem:
    """A coarse mesh of 20-node elements, or with other `fields`."""
    fem: Fem = registry.plugin("fem", "solid")(**{"edge_mm": 6.0, "element": "hex20", **fields})
    return fem


def balloon() -> Finger:
    """A finger of neo-Hooke material that bursts far below its highest pressure."""
    return replace(pneunet(chambers=1, max_kpa=300.0), material=Yeoh(c2_mpa=0.0))
