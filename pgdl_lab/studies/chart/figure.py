"""The chart as a figure: error over time, log-log, the Pareto front marked and every point labelled."""

import itertools
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pgdl_lab.core.files import replacing
from pgdl_lab.studies.chart.labels import place
from pgdl_lab.studies.chart.point import TIE_ERROR, TIE_TIME, Point, pareto
from pgdl_lab.studies.chart.reference import Errors

# Colour, marker and size; the table is drawn largest and first, as it often lies under the surrogate made from it.
LOOKS = {"table": ("C2", "D", 11), "finite elements": ("C0", "s", 7), "surrogate": ("C1", "o", 6)}
LINE = 110  # characters that fit across the figure
OTHER = ("C3", "^", 7)


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
    from matplotlib.ticker import NullFormatter

    panels: list[tuple[str, Callable[[Point], float], list[Point]]] = [
        ("time per query of the whole field (s)", lambda point: 1e-3 * point.query_ms, list(points)),
        ("time to train (s)", lambda point: point.train_s, [point for point in points if point.train_s > 0]),
        (f"simulate + train + {queries:,} queries (s)", lambda point: point.end_to_end_s(queries), list(points)),
    ]
    figure, axes = plt.subplots(3, 1, figsize=(9, 12), layout="constrained", sharey=True)
    for axis, (label, seconds, shown) in zip(axes, panels, strict=True):
        axis.set(xscale="log", yscale="log", xlabel=label)
        _panel(axis, shown, seconds)
        axis.axhspan(0, uncertainty.rms_mm, color="0.88", zorder=0)
        axis.grid(alpha=0.3)
        axis.margins(0.12, 0.08)
        axis.xaxis.set_minor_formatter(NullFormatter())  # whole decades are labelled, and there are at least two
        low, high = np.log10(axis.get_xlim())
        if shown and high - low < 2:
            axis.set_xlim(10 ** np.floor(low), 10 ** np.ceil(high))
    # a table of the data themselves would stretch the axis down to nothing
    least = [point.surrogate.rms_mm for point in points if point.surrogate and point.kind == "surrogate"]
    axes[0].set_ylim(min([uncertainty.rms_mm, *least]) / 3, None)
    figure.supylabel("RMS error of the displacement (mm)")
    for kind, (colour, marker, size) in LOOKS.items():
        axes[0].plot([], [], marker, color=colour, ms=size, label=kind)
    axes[0].plot([], [], "o", color="0.4", mfc="white", label="the surrogate's own part")
    axes[0].plot([], [], color="0.3", lw=1, drawstyle="steps-post", label="Pareto front")
    axes[0].fill_between([], [], color="0.85", label="uncertainty of the reference")
    axes[0].plot(
        [],
        [],
        " ",
        label=f"bold: on the front within {TIE_TIME - 1:.0%} of time, {TIE_ERROR - 1:.0%} of error",
    )
    figure.legend(loc="outside lower center", ncols=3, frameon=False, title=_missing(points))
    figure.suptitle(_wrapped(title), fontsize="medium")
    figure.canvas.draw()  # the layout has to stand before there is room to look for
    figure.set_layout_engine("none")
    for axis, (_, seconds, shown) in zip(axes, panels, strict=True):
        _label(axis, [point for point in shown if point.total], seconds)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=140)
    plt.close(figure)


def _missing(points: Sequence[Point]) -> str:
    """What is not shown, and why; failures are counted too."""
    failed = [f"{point.label}: {point.failed.partition(':')[0].partition(' (')[0]}" for point in points if point.failed]
    return _wrapped("Not shown: " + "; ".join(failed)) if failed else ""


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, LINE))


def _panel(panel: Any, points: list[Point], seconds: Callable[[Point], float]) -> None:
    front = pareto(points, seconds)
    heights = [(seconds(point), point.total.rms_mm) for point in front if point.total]
    if heights:
        panel.step(*zip(*heights, strict=True), where="post", color="0.3", lw=1, zorder=1)
    for point in sorted(points, key=lambda point: -LOOKS.get(point.kind, OTHER)[2]):
        if point.total is None:
            continue
        (colour, marker, size), x = LOOKS.get(point.kind, OTHER), seconds(point)
        if point.surrogate:
            panel.plot([x, x], [point.total.rms_mm, point.surrogate.rms_mm], color=colour, lw=0.6, alpha=0.6)
            panel.plot(x, point.surrogate.rms_mm, marker, color=colour, mfc="white", ms=4)
        best = point in front
        panel.plot(
            x, point.total.rms_mm, marker, color=colour, ms=size + 2 * best, mec="black" if best else "white",
            mew=1.2 if best else 0.6, alpha=0.85,
        )  # fmt: skip


def _label(panel: Any, points: list[Point], seconds: Callable[[Point], float]) -> None:
    front = pareto(points, seconds)
    places = [(seconds(point), point.total.rms_mm) for point in points if point.total]
    corners = [at for at, point in sorted(zip(places, points, strict=True), key=lambda each: each[0]) if point in front]
    lines = [(at, (at[0], point.surrogate.rms_mm)) for at, point in zip(places, points, strict=True) if point.surrogate]
    for one, other in itertools.pairwise(corners):
        lines += [(one, (other[0], one[1])), ((other[0], one[1]), other)]
    labels = [
        panel.text(*at, point.label, fontsize=9, weight="bold" if point in front else "normal")
        for at, point in zip(places, points, strict=True)
    ]
    place(panel, places, labels, lines)
