"""The silicone finger with a pneumatic network: chambers in a row on a common channel."""

from dataclasses import dataclass

import numpy as np

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.profile import Profile, Region


@register("finger", "pneunet")
@dataclass(frozen=True)
class Pneunet(ExtrudedFinger):
    """PneuNets finger after Table I of the paper; what the paper leaves open is marked so.

    From the paper: Table I, the material (Yeoh, C₁ = 0.11 MPa, C₂ = 0.02 MPa, ν = 0.49) and the highest pressure. From
    the literature: the density, that of the silicone Elastosil M 4601 by its data sheet, to which these coefficients
    belong. Calibrated: `root_mm`, `base_mm`, `bridge_mm` and `width_mm`, by a search for the extremes of the paper's
    FEA at 50 kPa (u_x −63.426 … 11.234 mm, u_z −105.24 … 0.25 mm); the search left u_z at −107.71 mm, and the width was
    then taken from 13.3 to 13.2 mm to share that out: u_x −62.52 … 11.19 mm, u_z −107.02 … 0.17 mm. Many other choices
    meet these extremes too. Chosen: the side walls, as thick as the others. `finger=pneunet_reference`: round values.

    Attributes
    ----------
    chambers
        Number of chambers, m (Table I).
    chamber_length_mm
        Outer length of a chamber along x, l (Table I; read as the outer length) [mm].
    wall_mm
        Thickness of the chamber walls across x and of their roof, t (Table I) [mm].
    gap_mm
        Distance between neighbouring chambers, s (Table I) [mm].
    height_mm
        Height of the network above the base, from the channel's floor to the roof's outside: h = 14 mm of Table I, read
        as the inner height, and the roof [mm].
    channel_mm
        Height of the channel that joins the chambers, d (Table I) [mm].
    base_mm
        Thickness below the channel (left open by the paper, calibrated) [mm].
    bridge_mm
        Thickness of the solid above the channel, between the chambers, down to which the gaps are cut (left open,
        calibrated) [mm].
    root_mm, tip_mm
        Solid blocks before the first (calibrated) and after the last chamber (none), left open [mm].
    """

    open_mm = {
        "root_mm": (0.0, 8.0),
        "base_mm": (4.0, 7.0),
        "bridge_mm": (1.5, 3.0),
        "width_mm": (12.0, 16.0),
    }

    width_mm: float = 13.2
    chambers: int = 10
    chamber_length_mm: float = 10.5
    wall_mm: float = 3.0
    gap_mm: float = 1.0
    height_mm: float = 17.0
    channel_mm: float = 2.0
    base_mm: float = 5.55
    bridge_mm: float = 2.1
    root_mm: float = 3.55
    tip_mm: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.chambers < 1:
            raise InputError(f"finger.chambers is {self.chambers}; a finger has at least 1.")
        lengths = ("chamber_length_mm", "wall_mm", "gap_mm", "height_mm", "channel_mm", "base_mm", "bridge_mm")
        self._require_positive(*lengths)
        self._require_positive("root_mm", "tip_mm", zero=True)
        if 2 * self.wall_mm >= self.chamber_length_mm:
            raise InputError(
                f"finger.wall_mm is {self.wall_mm} mm; two walls must be thinner than the chamber "
                f"({self.chamber_length_mm} mm long), else there is no cavity."
            )
        if self.channel_mm + self.bridge_mm + self.wall_mm >= self.height_mm:
            raise InputError(
                f"finger.height_mm is {self.height_mm} mm; it must exceed channel, bridge and roof together "
                f"({self.channel_mm + self.bridge_mm + self.wall_mm} mm), else there is no chamber above the bridge."
            )

    def profile(self) -> Profile:
        gap, solid, cavity = Region.GAP, Region.SOLID, Region.CAVITY
        #             base   channel bridge  chamber roof
        block = [solid, solid, solid, solid, solid]
        chamber = [solid, cavity, cavity, cavity, solid]
        inner_wall = [solid, cavity, solid, solid, solid]
        between = [solid, cavity, solid, gap, gap]

        cavity_mm = self.chamber_length_mm - 2 * self.wall_mm
        columns = [(self.root_mm, block)]
        for number in range(self.chambers):
            first, last = number == 0, number == self.chambers - 1
            columns += [
                (self.wall_mm, block if first else inner_wall),
                (cavity_mm, chamber),
                (self.wall_mm, block if last else inner_wall),
                (0.0 if last else self.gap_mm, between),
            ]
        columns.append((self.tip_mm, block))
        roof = self.base_mm + self.height_mm
        floors = np.cumsum([0.0, self.base_mm, self.channel_mm, self.bridge_mm])
        return Profile.from_columns([*floors, roof - self.wall_mm, roof], columns)
