"""The chart as a figure: error over time, log-log, the Pareto front marked and every point labelled."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.chart.point import Point, pareto
from pgdl_lab.chart.reference import Errors
from pgdl_lab.files import replacing

CROWDED = (1.2, 0.25)  # decades along and across: labels of points so near to each other are stacked
COLOURS = {"finite elements": "C0", "surrogate": "C1", "table": "C2"}


def draw(points: Sequence[Point], uncertainty: Errors, title: str, queries: int, path: Path) -> None:
    """Write a PNG with three panels: time per query, to train, and from end to end.

    Full markers are total errors; hollow ones, joined to them, are what the surrogate adds to the error of its data.

    Parameters
    ----------
    uncertainty
        Of the reference: errors below it, the grey band, are not told apart.
    queries
        Number of queries in the time from end to end.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels: list[tuple[str, Callable[[Point], float], list[Point]]] = [
        ("time per query of the whole field (s)", lambda point: 1e-3 * point.query_ms, list(points)),
        ("time to train (s)", lambda point: point.train_s, [point for point in points if point.train_s > 0]),
        (f"simulate + train + {queries:,} queries (s)", lambda point: point.end_to_end_s(queries), list(points)),
    ]
    figure, axes = plt.subplots(1, 3, figsize=(16, 6), layout="constrained", sharey=True)
    for axis, (label, seconds, shown) in zip(axes, panels, strict=True):
        _panel(axis, shown, seconds)
        axis.axhspan(0, uncertainty.rms_mm, color="0.85", zorder=0)
        axis.set(xscale="log", yscale="log", xlabel=label)
        axis.grid(alpha=0.3)
        axis.margins(0.18, 0.1)
    # a table of the data themselves would stretch the axis down to nothing
    least = [point.surrogate.rms_mm for point in points if point.surrogate and point.kind == "surrogate"]
    axes[0].set_ylim(min([uncertainty.rms_mm, *least]) / 3, None)
    axes[0].set_ylabel("RMS error of the displacement (mm)")
    for kind, colour in COLOURS.items():
        axes[0].plot([], [], "o", color=colour, label=kind)
    axes[0].plot([], [], "o", color="0.4", mfc="white", label="the surrogate's own part")
    axes[0].plot([], [], color="0.3", lw=1, drawstyle="steps-post", label="Pareto front")
    axes[0].fill_between([], [], color="0.85", label="uncertainty of the reference")
    figure.legend(loc="outside lower center", ncols=6, frameon=False)
    figure.suptitle(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=140)
    plt.close(figure)


def _panel(panel: Any, points: list[Point], seconds: Callable[[Point], float]) -> None:
    shown = sorted((point for point in points if point.total), key=seconds)
    front = pareto(shown, seconds)
    heights = [(seconds(point), point.total.rms_mm) for point in front if point.total]
    if heights:
        panel.step(*zip(*heights, strict=True), where="post", color="0.3", lw=1, zorder=1)
    labelled: list[NDArray[np.float64]] = []
    for point in shown:
        assert point.total is not None
        colour, x = COLOURS.get(point.kind, "C3"), seconds(point)
        place = np.log10([x, point.total.rms_mm])
        crowd = sum((np.abs(place - other) < CROWDED).all() for other in labelled)
        labelled.append(place)
        if point.surrogate:
            panel.plot([x, x], [point.total.rms_mm, point.surrogate.rms_mm], color=colour, lw=0.6, alpha=0.6)
            panel.plot(x, point.surrogate.rms_mm, "o", color=colour, mfc="white", ms=4)
        best = point in front
        panel.plot(x, point.total.rms_mm, "o", color=colour, ms=8 if best else 5, mec="black" if best else "none")
        panel.annotate(
            point.label, (x, point.total.rms_mm), xytext=(4, 6 + 9 * crowd), textcoords="offset points",
            fontsize=7, weight="bold" if best else "normal",
        )  # fmt: skip
