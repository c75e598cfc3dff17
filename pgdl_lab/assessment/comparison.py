"""Simulated and predicted displacements of all snapshots, side by side."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.surrogate.curvature import mean_curvature_per_m, rms_distance_mm

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """A surrogate's predictions beside the snapshots they should match.

    Attributes
    ----------
    snapshots
        The simulation, P pressures and N points.
    predicted_mm
        (P, N, d), displacements by the surrogate [mm].
    train
        (n,), indices of the training points.
    bars_mm
        (P, N), the surrogate's own error bars [mm], or None if it has none.
    selection
        (m,), indices of the points that a search selects by, which count as seen.
    """

    snapshots: Dataset
    predicted_mm: Floats
    train: NDArray[np.int64]
    bars_mm: Floats | None = None
    selection: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @cached_property
    def unseen(self) -> NDArray[np.bool_]:
        """(P, N), the points that were neither trained on nor selected by."""
        mask = np.ones(self.predicted_mm.shape[:2], dtype=bool)
        mask.flat[self.train] = False
        mask.flat[self.selection] = False
        return mask

    @cached_property
    def error_mm(self) -> Floats:
        """(P, N, d), predicted minus simulated displacement [mm]."""
        return self.predicted_mm - self.snapshots.displacements

    def seen_snapshots(self) -> NDArray[np.bool_]:
        """(P,), the snapshots that gave training points."""
        seen = np.zeros(len(self.unseen), dtype=bool)
        seen[self.train // self.unseen.shape[1]] = True
        return seen

    def mse_mm2(self) -> dict[str, float]:
        """Mean squared error of each component over all unseen points [mm²]."""
        return self._by_axis((self.error_mm[self.unseen] ** 2).mean(axis=0))

    def _by_axis(self, values: Floats) -> dict[str, float]:
        return dict(zip(self.snapshots.domain.axes, values.tolist(), strict=True))

    def error(self) -> dict[str, float | None]:
        """Lengths of the error, over all unseen points, and of the tip at all pressures.

        Returns
        -------
        "rms_mm" and "largest_mm" [mm], "tip_mm", the largest at the tip [mm], and "tip_percent", the same of the
        largest displacement there [%], None where it does not move or there is no base line, whose end it is.
        """
        length, tip = np.linalg.norm(self.error_mm, axis=2), self.snapshots.domain.base[-1:]
        unseen, tip_mm = length[self.unseen], float(length[:, tip].max(initial=0.0))
        moved = float(np.linalg.norm(self.snapshots.displacements[:, tip], axis=2).max(initial=0.0))
        return {
            "rms_mm": float(np.sqrt((unseen**2).mean())),
            "tip_mm": tip_mm if len(tip) else None,
            "tip_percent": 100 * tip_mm / moved if moved else None,
            "largest_mm": float(unseen.max()),
        }

    def selection_mm2(self) -> dict[str, float] | None:
        """Mean squared error of each component over the points that a search selects by [mm²]; None without any."""
        if not len(self.selection):
            return None
        errors_mm = self.error_mm.reshape(-1, self.error_mm.shape[2])
        return self._by_axis((errors_mm[self.selection] ** 2).mean(axis=0))

    def error_bar(self) -> dict[str, float] | None:
        """Share of the unseen points whose error the bar covers, by component, and the bar's median [mm]."""
        if self.bars_mm is None:
            return None
        bars = self.bars_mm[self.unseen]
        covered = self._by_axis((np.abs(self.error_mm[self.unseen]) <= bars[:, None]).mean(axis=0))
        return {**{f"covered_{axis}": share for axis, share in covered.items()}, "median_mm": float(np.median(bars))}

    def by_pressure(self) -> list[dict[str, Any]]:
        """Errors of each snapshot over its unseen points.

        "seen" tells whether it gave training points, "covered" which share of the errors the error bars cover.
        """
        rows = []
        bars = [None] * len(self.unseen) if self.bars_mm is None else self.bars_mm
        for kpa, seen, unseen, error, bar in zip(
            self.snapshots.pressures_kpa, self.seen_snapshots(), self.unseen, self.error_mm, bars, strict=True
        ):
            # a snapshot that was trained on as a whole has no unseen points: its training errors stand in
            which = unseen if unseen.any() else np.ones_like(unseen)
            judged = error[which]
            mse = self._by_axis((judged**2).mean(axis=0))
            rows.append({
                "kpa": float(kpa),
                "seen": bool(seen),
                **{f"mse_{axis}_mm2": value for axis, value in mse.items()},
                "max_abs_mm": float(np.abs(judged).max()),
                "covered": None if bar is None else float((np.abs(judged) <= bar[which, None]).mean()),
            })  # fmt: skip
        return rows

    def extremes_mm(self) -> dict[str, dict[str, list[float]]]:
        """Least and greatest displacement at the highest pressure, simulated and predicted [mm]."""
        return {
            who: {
                axis: [float(u[:, i].min()), float(u[:, i].max())] for i, axis in enumerate(self.snapshots.domain.axes)
            }
            for who, u in (("fem", self.snapshots.displacements[-1]), ("surrogate", self.predicted_mm[-1]))
        }

    def base_lines_mm(self, snapshot: int) -> tuple[Floats, Floats]:
        """X and z of the deformed base lines (B, 2) of simulation and surrogate [mm]."""
        base = self.snapshots.domain.base
        line = self.snapshots.domain.points_mm[base]
        fields = self.snapshots.displacements, self.predicted_mm
        fem, surrogate = ((line + field[snapshot, base])[:, [0, -1]] for field in fields)
        return fem, surrogate

    def curvature(self) -> list[dict[str, float]]:
        """Mean curvature of the base line by pressure and the distance between the two base lines."""
        rows = []
        for i, kpa in enumerate(self.snapshots.pressures_kpa):
            fem, surrogate = self.base_lines_mm(i)
            rows.append({
                "kpa": float(kpa),
                "fem_per_m": mean_curvature_per_m(fem),
                "surrogate_per_m": mean_curvature_per_m(surrogate),
                "rms_distance_mm": rms_distance_mm(fem, surrogate),
            })  # fmt: skip
        return rows
