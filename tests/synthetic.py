"""Made-up snapshots of a comb-shaped finger: no simulation, but the features that make the real ones hard to learn."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.domain import Domain

CHAMBERS, CHAMBER_MM, GAP_MM, FOOT_MM, HEIGHT_MM, MAX_KPA = 10, 10.5, 1.0, 8.0, 17.0, 50.0
PITCH_MM = CHAMBER_MM + GAP_MM
LENGTH_MM = CHAMBERS * PITCH_MM - GAP_MM


def comb(cell_mm: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points (N, 2) and triangles (T, 3) of a face of 10 chambers parted by slots of 1 mm above z = 8."""
    across = max(2, round(CHAMBER_MM / cell_mm))
    x = np.concatenate(
        [start + np.linspace(0, CHAMBER_MM, across + 1) for start in PITCH_MM * np.arange(CHAMBERS)]
        + [start + CHAMBER_MM + np.array([GAP_MM / 2]) for start in PITCH_MM * np.arange(CHAMBERS - 1)]
    )
    x = np.sort(x)
    below, above = round(FOOT_MM / cell_mm), round((HEIGHT_MM - FOOT_MM) / cell_mm)
    z = np.concatenate([np.linspace(0, FOOT_MM, below + 1), np.linspace(FOOT_MM, HEIGHT_MM, above + 1)[1:]])
    grid = np.arange(len(x) * len(z)).reshape(len(x), len(z))
    mid_x, mid_z = (x[1:] + x[:-1])[:, None] / 2, (z[1:] + z[:-1])[None] / 2
    solid = (mid_z < FOOT_MM) | (mid_x % PITCH_MM < CHAMBER_MM)
    corners = [part[solid] for part in (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:])]
    triangles = np.concatenate([np.stack([corners[i] for i in pick], axis=1) for pick in ((0, 1, 2), (0, 2, 3))])
    used, renumbered = np.unique(triangles, return_inverse=True)
    points = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)[used]
    return points, renumbered.reshape(-1, 3)


def bend(points: NDArray[np.float64], kpa: float) -> NDArray[np.float64]:
    """Displacements (N, 2) [mm]: the foot bends as a beam, each chamber turns as a rigid body."""
    share = kpa / MAX_KPA
    line = np.linspace(0, LENGTH_MM, 4001)
    angle = -(0.9 * (1 - (1 - line / LENGTH_MM) ** 2) + 1.6 * share * (1 + 0.3 * share) * line / LENGTH_MM)
    step = np.diff(line, prepend=0)
    axis_x, axis_z = np.cumsum(np.cos(angle) * step), np.cumsum(np.sin(angle) * step)

    def carried(foot_x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where the points lie if they are tied rigidly to the base line at `foot_x` (N,)."""
        turn = np.interp(foot_x, line, angle)
        lever_x, lever_z = points[:, 0] - foot_x, points[:, 1]
        return np.stack(
            [
                np.interp(foot_x, line, axis_x) + np.cos(turn) * lever_x - np.sin(turn) * lever_z,
                np.interp(foot_x, line, axis_z) + np.sin(turn) * lever_x + np.cos(turn) * lever_z,
            ],
            axis=1,
        )

    chamber = np.minimum(points[:, 0] // PITCH_MM, CHAMBERS - 1)
    rise = np.clip((points[:, 1] - FOOT_MM) / 4, 0, 1)[:, None]
    rigid = rise**2 * (3 - 2 * rise) * (points[:, 0] % PITCH_MM <= CHAMBER_MM + 1e-9)[:, None]
    # the first chamber turns about the root, where the angle is zero: that holds the clamp still
    centre = np.where(chamber > 0, chamber * PITCH_MM + CHAMBER_MM / 2, 0)
    displaced = (1 - rigid) * carried(points[:, 0]) + rigid * carried(centre)
    return displaced - points


def snapshots(cell_mm: float = 0.7, count: int = 100) -> Dataset:
    """Snapshots of about 4,000 points (2.5 mm cells: about 400) at `count` equal pressure steps to 50 kPa."""
    points, triangles = comb(cell_mm)
    pressures = MAX_KPA * np.arange(1, count + 1) / count
    base = np.flatnonzero(points[:, 1] == 0)
    clamp = np.flatnonzero(points[:, 0] == 0)
    domain = Domain(points, triangles, base=base[np.argsort(points[base, 0])], clamp=clamp)
    moved = np.stack([bend(points, kpa) for kpa in pressures])
    return Dataset.path(domain, pressures, moved, provenance={"origin": "synthetic"})


def with_domain(data: Dataset, **changes: Any) -> Dataset:
    """The same fields on a domain with other arrays."""
    return replace(data, domain=replace(data.domain, **changes))
