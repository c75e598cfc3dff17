"""The printed finger with local bending joints: groups of chambers between stiff phalanges."""

from dataclasses import dataclass, field

import numpy as np

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.material import Material, Yeoh
from pgdl_lab.mechanics.profile import Profile, Region


@register("finger", "joints")
@dataclass(frozen=True)
class Joints(ExtrudedFinger):
    """Finger that bends at joints of a few thin-walled chambers each; the phalanges carry only the air channel.

    From the paper: the highest pressure, 45 kPa, and the extremes to meet. From the literature: the material, Elastic
    50A resin with the Yeoh coefficients that go with doi 10.1016/j.sna.2021.113199; the paper does not name its own.
    Calibrated: `phalanx_mm`, `tip_mm` and `chamber_height_mm`, to u_z −69.94 … 0.21 mm at 45 kPa, by
    a search like `-m sweep=calibrate finger=joints`; u_z runs from −69.85 to 0.085 mm. The other dimensions are chosen:
    round values for a printed finger. Two extremes do not determine a finger; others meet them too.

    Attributes
    ----------
    joints
        Number of joints.
    chambers
        Chambers of each joint.
    chamber_mm
        Inner length of a chamber along x [mm].
    wall_mm
        Thickness of the walls across x and of the roof [mm].
    gap_mm
        Distance between neighbouring chambers of a joint [mm].
    phalanx_mm
        Length of the solid between two joints [mm].
    root_mm, tip_mm
        Solid before the first and after the last joint [mm].
    base_mm, channel_mm, bridge_mm, chamber_height_mm
        From the bottom up: base, air channel, solid between the chambers, chamber above it [mm].
    """

    open_mm = {
        "phalanx_mm": (12.0, 18.0),
        "tip_mm": (10.0, 20.0),
        "chamber_height_mm": (5.0, 9.0),
    }

    max_kpa: float = 45.0
    material: Material = field(default_factory=lambda: Yeoh(c1_mpa=0.5056, c2_mpa=0.0, c3_mpa=0.002562))
    width_mm: float = 16.0
    side_wall_mm: float = 2.0
    joints: int = 3
    chambers: int = 3
    chamber_mm: float = 4.0
    wall_mm: float = 2.0
    gap_mm: float = 1.0
    phalanx_mm: float = 15.6
    root_mm: float = 10.0
    tip_mm: float = 13.5
    base_mm: float = 3.0
    channel_mm: float = 2.0
    bridge_mm: float = 2.0
    chamber_height_mm: float = 7.5

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("joints", "chambers"):
            if getattr(self, name) < 1:
                raise InputError(f"finger.{name} is {getattr(self, name)}; a finger has at least 1.")
        lengths = ("chamber_mm", "wall_mm", "gap_mm", "phalanx_mm", "base_mm", "channel_mm", "bridge_mm")
        self._require_positive(*lengths, "chamber_height_mm")
        self._require_positive("root_mm", "tip_mm", zero=True)

    def profile(self) -> Profile:
        gap, solid, cavity = Region.GAP, Region.SOLID, Region.CAVITY
        #             base   channel bridge  chamber roof
        block = [solid, solid, solid, solid, solid]
        bored = [solid, cavity, solid, solid, solid]
        chamber = [solid, cavity, cavity, cavity, solid]
        between = [solid, cavity, solid, gap, gap]

        columns = [(self.root_mm, block), (self.wall_mm, block)]
        for joint in range(self.joints):
            if joint:
                columns.append((self.phalanx_mm, bored))
            for number in range(self.chambers):
                if number:
                    columns += [(self.wall_mm, bored), (self.gap_mm, between), (self.wall_mm, bored)]
                columns.append((self.chamber_mm, chamber))
        columns += [(self.wall_mm, block), (self.tip_mm, block)]
        heights = [self.base_mm, self.channel_mm, self.bridge_mm, self.chamber_height_mm, self.wall_mm]
        return Profile.from_columns(np.cumsum([0.0, *heights]).tolist(), columns)
