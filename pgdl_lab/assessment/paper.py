"""The paper's own figures, for its own fingers: what our numbers stand beside.

All are read from its text (sections IV-B1 and IV-B2, Table II); what it shows only in pictures is left out. Its fingers
are not the ones simulated here to the last dimension, so displacements compare in kind, errors in size.
"""

from dataclasses import dataclass, field

from pgdl_lab.core.registry import describe
from pgdl_lab.core.split import Split
from pgdl_lab.mechanics.finger import Finger

Extremes = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Published:
    """What the paper reports for one finger and one split.

    Attributes
    ----------
    mse_mm2
        Mean squared error by share of the highest pressure: text for x and for z [mm²].
    fem_mm, surrogate_mm
        Least and greatest displacement at the highest pressure by component, in its FEA and in its PGDL model [mm].
    """

    mse_mm2: dict[float, tuple[str, str]] = field(default_factory=dict)
    fem_mm: Extremes = field(default_factory=dict)
    surrogate_mm: Extremes = field(default_factory=dict)


SEEN = dict.fromkeys((0.2, 0.4, 0.6, 0.8, 1.0), ("1e-4 … 1e-3", "1e-4 … 1e-3"))  # Fig. 7 and the text on it
PNEUNET_FEM: Extremes = {"x": (-63.426, 11.234), "z": (-105.24, 0.25)}  # Figs. 4(a) and 5(a)

PUBLISHED: dict[tuple[str, str], Published] = {
    ("pneunet", "random"): Published(SEEN, PNEUNET_FEM, {"x": (-63.43, 11.26), "z": (-105.16, 0.23)}),
    ("pneunet", "extrapolate"): Published(
        {0.90: ("0.004", "0.002"), 0.94: ("0.008", "0.004"), 1.0: ("0.017", "0.007")},  # Table II
        PNEUNET_FEM,
    ),
    ("joints", "random"): Published(SEEN, {"z": (-69.94, 0.21)}, {"z": (-70.10, 0.21)}),  # Fig. 5(b) and (e)
    ("bellows", "random"): Published(SEEN, {"x": (-150.38, 5.015)}, {"x": (-150.63, 5.00)}),  # Fig. 4(c) and (f)
}


def published(finger: str, split: str) -> Published:
    """The paper's figures for its own finger and split of these names; empty where it has none."""
    return PUBLISHED.get((finger, split), Published())


def comparable(finger: Finger, split: Split) -> Published:
    """The paper's figures that ours may stand beside.

    None beside another finger than the paper's or other pressures: all values must be the defaults of its plugin. Of
    the paper's surrogate none beside another split, which trains on other points.
    """
    found = published(describe(finger)["name"], describe(split)["name"])
    if found == Published() or finger != type(finger)():
        return Published()
    return found if split == type(split)() else Published(fem_mm=found.fem_mm)
