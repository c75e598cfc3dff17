"""Labels of points in a plot: near their points, inside the panel, and clear of each other and of all markers."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MARKER, CLEARANCE = 7.0, 2.0  # kept clear around points, and around labels and lines [pixels]
RINGS = np.arange(0.0, 30.0, 0.5)  # distances that are tried in turn, in heights of a label
ANGLES = np.deg2rad([20, -20, 160, -160, 90, -90, 50, -50, 130, -130, 0, 180])  # and directions
LEADER = 1.0  # from this distance on a line leads to the point, in heights of a label


def place(
    panel: Any, places: Sequence[tuple[float, float]], labels: Sequence[Any], lines: Sequence[tuple[Any, Any]]
) -> None:
    """Move `labels` to free room beside their points and lead thin lines to those further away.

    Each takes the nearest room that is left, those in the thick of it first.

    Parameters
    ----------
    panel
        Axes with their final limits and layout.
    places
        Of the points, in data.
    labels
        Text artists, one for each point, on the axes.
    lines
        Pairs of ends of upright and level lines to keep clear of too, in data.
    """
    if not labels:
        return
    renderer = panel.figure.canvas.get_renderer()
    points = panel.transData.transform(np.reshape(places, (-1, 2)))
    ends = panel.transData.transform(np.reshape(lines, (-1, 2))).reshape(-1, 2, 2)
    inside = np.reshape(panel.get_window_extent(renderer).get_points(), 4)
    # boxes (B, 4): left, bottom, right, top
    taken = np.vstack([np.hstack([points - MARKER, points + MARKER]), np.hstack([ends.min(axis=1), ends.max(axis=1)])])
    scale = np.ptp(points, axis=0).max() + 1.0
    crowd = np.exp(-np.linalg.norm(points[:, None] - points, axis=2) / (0.05 * scale)).sum(axis=1)
    for index in np.argsort(-crowd, kind="stable"):
        size = labels[index].get_window_extent(renderer).size
        distance, centre = _room(points[index], size, inside, taken)
        box = np.hstack([centre - size / 2, centre + size / 2])
        taken = np.vstack([taken, box])
        labels[index].set(position=panel.transData.inverted().transform(centre), ha="center", va="center")
        if distance > LEADER:
            nearest = np.clip(points[index], box[:2], box[2:])
            leader = panel.transData.inverted().transform([points[index], nearest])
            panel.plot(*leader.T, color="0.4", lw=0.5, zorder=1.5, scalex=False, scaley=False)


def _room(point: Array, size: Array, inside: Array, taken: Array) -> tuple[float, Array]:
    """Centre [pixels] of the nearest room for a label of `size`, and its distance in heights; the last if none is."""
    for distance in RINGS:
        for angle in ANGLES:
            direction = np.array([np.cos(angle), np.sin(angle)])
            centre = point + direction * (size / 2 + MARKER + distance * size[1])
            box = np.hstack([centre - size / 2 - CLEARANCE, centre + size / 2 + CLEARANCE])
            if (box[:2] >= inside[:2]).all() and (box[2:] <= inside[2:]).all() and not _meets(box, taken):
                return distance, centre
    return distance, centre


def _meets(box: Array, boxes: Array) -> bool:
    """Whether `box` (4,) overlaps one of `boxes` (B, 4)."""
    return bool(np.hstack([box[:2] < boxes[:, 2:], box[2:] > boxes[:, :2]]).all(axis=1).any())
