"""Whether a simulation observes what moves: checks of a result that hold for every finger and every model."""

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.mechanics.finger import Finger

REACH = 0.1  # of the length: how far from the clamp and from the tip the base line may end
GAP = 3.0  # times the usual spacing of its points is a gap in it, if it is longer than that part, too
ELSEWHERE = 2.0  # times as much motion in the body as in what is observed is worth a word


def doubts(snapshots: Dataset, finger: Finger) -> list[str]:
    """What of the result may not be as meant, in sentences."""
    found = [_base_line(snapshots)]
    if snapshots.body is not None and len(snapshots.pressures_kpa):
        found += [_across(snapshots, finger), _elsewhere(snapshots)]
    return [sentence for sentence in found if sentence]


def _base_line(snapshots: Dataset) -> str:
    """Whether the base line, whose last point is the tip of every surrogate, reaches from the clamp to the far end."""
    x = snapshots.domain.points_mm[:, 0] if snapshots.body is None else snapshots.body.domain.points_mm[:, 0]
    base, held = (
        np.sort(snapshots.domain.points_mm[snapshots.domain.base, 0]),
        snapshots.domain.points_mm[snapshots.domain.clamp, 0],
    )
    length, clamped = float(np.ptp(x)), max(float(x.min()), float(held.max(initial=-np.inf)))
    body = f"but the body x = {x.min():.4g} to {x.max():.4g} mm: the observed face is not the side of the finger."
    if not len(base):
        return f"The base line, whose end is the tip of every surrogate, has no points, {body}"
    if base[0] > clamped + REACH * length or base[-1] < x.max() - REACH * length:
        return (
            f"The base line, whose end is the tip of every surrogate, spans x = {base[0]:.4g} to {base[-1]:.4g}, {body}"
        )
    gaps = np.diff(base)
    if len(gaps) and gaps.max() > max(REACH * length, GAP * float(np.median(gaps))):
        at = int(gaps.argmax())
        return (
            f"The base line has no points from x = {base[at]:.4g} to {base[at + 1]:.4g} mm, where nothing looks to the "
            "side: surrogates are sure where there are points alone."
        )
    return ""


def _across(snapshots: Dataset, finger: Finger) -> str:
    """Whether the body moves mostly along y, which is not observed."""
    assert snapshots.body is not None
    x, y, z = np.abs(snapshots.body.displacements[-1]).max(axis=0)
    if y <= max(x, z):
        return ""
    ask = ": is z up?" if finger.planar else "."
    return (
        f"Most of the motion at {snapshots.body.pressures_kpa[-1]:.4g} kPa, {y:.3g} mm, is along y, which no surrogate "
        f"has; along x and z the body moves by at most {x:.3g} and {z:.3g} mm{ask}"
    )


def _elsewhere(snapshots: Dataset) -> str:
    """Whether the body moves mostly where it is not observed."""
    assert snapshots.body is not None
    moved = float(np.linalg.norm(snapshots.body.displacements[-1][:, [0, 2]], axis=1).max())
    seen = float(np.linalg.norm(snapshots.displacements[-1], axis=1).max())
    if moved <= ELSEWHERE * seen:
        return ""
    return (
        f"At {snapshots.body.pressures_kpa[-1]:.4g} kPa the observed side face moves by at most {seen:.3g} mm, but "
        f"another part of the body by {moved:.3g} mm, of which no surrogate tells."
    )
