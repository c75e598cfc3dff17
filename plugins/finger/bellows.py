"""The bellows finger: one long chamber on a flat base, its roof folded so that it can stretch."""

from dataclasses import dataclass, field

import numpy as np

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.material import Material, Yeoh
from pgdl_lab.mechanics.profile import Profile, Region


@register("finger", "bellows")
@dataclass(frozen=True)
class Bellows(ExtrudedFinger):
    """Finger with a roof of square folds: crests and troughs of equal thickness over a common chamber.

    From the paper: the highest pressure, 120 kPa, and the extremes to meet. From the literature: the material, Elastic
    50A resin with the Yeoh coefficients that go with doi 10.1016/j.sna.2021.113199; the paper does not name its own.
    Calibrated: `width_mm`, `crest_mm`, `base_mm` and `fold_mm`, to u_x −150.38 … 5.015 mm at 120 kPa, by
    a search like `-m sweep=calibrate finger=bellows`; u_x runs from −149.41 to 4.98 mm. The other dimensions are
    chosen: long, low and with little room below the folds, since a higher or softer roof carries the front of the
    finger further than 5 mm. Two extremes do not determine a finger; others meet them too.

    Attributes
    ----------
    folds
        Number of crests.
    crest_mm
        Inner length of a crest along x [mm].
    trough_mm
        Outer length of a trough along x [mm].
    wall_mm
        Thickness of the folded roof and of the end walls [mm].
    base_mm
        Thickness of the flat base [mm].
    duct_mm
        Height of the chamber below the troughs [mm].
    fold_mm
        Height of the crests above the troughs [mm].
    root_mm, tip_mm
        Solid blocks before the first and after the last fold [mm].
    """

    open_mm = {
        "width_mm": (16.0, 22.0),
        "crest_mm": (3.0, 6.0),
        "base_mm": (2.0, 4.0),
        "fold_mm": (2.5, 5.0),
    }

    max_kpa: float = 120.0
    material: Material = field(default_factory=lambda: Yeoh(c1_mpa=0.5056, c2_mpa=0.0, c3_mpa=0.002562))
    width_mm: float = 18.5
    side_wall_mm: float = 2.0
    folds: int = 15
    crest_mm: float = 4.0
    trough_mm: float = 2.0
    wall_mm: float = 1.75
    base_mm: float = 3.05
    duct_mm: float = 2.0
    fold_mm: float = 3.7
    root_mm: float = 5.0
    tip_mm: float = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.folds < 1:
            raise InputError(f"finger.folds is {self.folds}; a bellows has at least 1.")
        self._require_positive("crest_mm", "trough_mm", "wall_mm", "base_mm", "duct_mm", "fold_mm")
        self._require_positive("root_mm", "tip_mm", zero=True)
        if self.fold_mm <= self.wall_mm:
            raise InputError(
                f"finger.fold_mm is {self.fold_mm} mm; it must exceed finger.wall_mm ({self.wall_mm} mm), "
                "else the roof has no folds."
            )

    def profile(self) -> Profile:
        gap, solid, cavity = Region.GAP, Region.SOLID, Region.CAVITY
        # From the bottom up: base, duct, trough's roof, flank, crest's roof; base and roofs, which bend, in two layers.
        base, roof = 2 * [solid], 2 * [solid]
        block = 8 * [solid]
        crest = [*base, *4 * [cavity], *roof]
        flank = [*base, cavity, *5 * [solid]]
        trough = [*base, cavity, *roof, *3 * [gap]]

        columns = [(self.root_mm, block), (self.wall_mm, block)]
        for number in range(self.folds):
            if number:
                columns += [(self.wall_mm, flank), (self.trough_mm, trough), (self.wall_mm, flank)]
            columns.append((self.crest_mm, crest))
        columns += [(self.wall_mm, block), (self.tip_mm, block)]
        half_base, half_roof = 2 * [self.base_mm / 2], 2 * [self.wall_mm / 2]
        heights = [*half_base, self.duct_mm, *half_roof, self.fold_mm - self.wall_mm, *half_roof]
        return Profile.from_columns(np.cumsum([0.0, *heights]).tolist(), columns)
