"""Figures of an assessment, as PNG files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.core.files import replacing
from pgdl_lab.core.plotting import from_the_side

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE: Any = {
    "font.size": 11,
    "axes.titlesize": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.edgecolor": "0.8",
    "savefig.dpi": 200,
}
TRAINED = "0.75"  # grey of the training range
WIDTH = 9.0  # of figures that take a whole page [inches]
SLENDER = 1.6  # times as wide as high: panels stand below each other, else side by side


def draw(
    comparison: Comparison,
    highlights: NDArray[np.int64],
    history: list[dict[str, float]],
    units: Mapping[str, str],
    folder: Path,
) -> list[Path]:
    """Write all figures to `folder`.

    Parameters
    ----------
    comparison
        Simulated and predicted displacements.
    highlights
        Indices of the snapshots whose base lines are shown.
    history
        Entries of the loss history, see `Record`; an empty one gives no such figure.
    units
        Units of the loss terms by their names.
    folder
        Where the PNG files go.
    """
    import matplotlib

    figures = {
        **{f"field_{axis}": _field_figure(comparison, i) for i, axis in enumerate(comparison.snapshots.domain.axes)},
        "base_lines": _base_lines(comparison, highlights),
        "mse_over_pressure": _mse_over_pressure(comparison),
        **({"loss_history": _loss_history(history, units)} if history else {}),
    }
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, build in figures.items():
        path = folder / f"{name}.png"
        with matplotlib.rc_context(STYLE), replacing(path) as temporary:
            build().savefig(temporary, format="png")
        paths.append(path)
    return paths


def _new(rows: int, columns: int, width: float, height: float, **options: Any) -> tuple[Figure, Any]:
    """A figure outside pyplot, which would keep it open and may want a screen."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def _field_figure(comparison: Comparison, component: int) -> Callable[[], Figure]:
    """One component at the highest pressure: simulation, surrogate and difference (the paper's Figs. 4, 5, 9)."""

    def build() -> Figure:
        snapshots, symbol = comparison.snapshots, f"$u_{comparison.snapshots.domain.axes[component]}$"
        triangles, plane = from_the_side(snapshots.domain), [0, -1]  # x and z
        fem, predicted = snapshots.displacements[-1], comparison.predicted_mm[-1]
        error = comparison.error_mm[-1, :, component]
        both = fem[:, component], predicted[:, component]
        low, high = min(u.min() for u in both), max(u.max() for u in both)
        bound = float(np.abs(error).max())
        panels = (
            ("FEM", fem, both[0], symbol, "viridis", (low, high)),
            ("surrogate", predicted, both[1], symbol, "viridis", (low, high)),
            ("surrogate − FEM", fem, error, f"Δ{symbol}", "RdBu_r", (-bound, bound)),
        )
        width, height = np.ptp((snapshots.domain.points_mm + fem)[:, plane], axis=0)
        slender = width > SLENDER * height
        rows, columns, beside = (3, 1, 0.7) if slender else (1, 3, 1.6)  # inches for title and colour bar
        panel = 0.8 * WIDTH / columns * height / width
        figure, axes = _new(rows, columns, WIDTH, rows * (panel + beside), sharex=True, sharey=True)
        for axis, (title, shift, values, label, colours, (least, most)) in zip(axes, panels, strict=True):
            x, z = (snapshots.domain.points_mm + shift)[:, plane].T
            shown = axis.tripcolor(x, z, triangles, values, shading="gouraud", cmap=colours, vmin=least, vmax=most)
            bar = figure.colorbar(shown, ax=axis, label=f"{label} [mm]", location="right" if slender else "bottom")
            bar.ax.locator_params(nbins=4)
            bar.ax.ticklabel_format(scilimits=(-3, 4))
            axis.set_title(f"{title}\n{_range(values)} mm")
            axis.set(aspect="equal")
        for axis in axes[-1:] if slender else axes:
            axis.set_xlabel("x [mm]")
        for axis in axes if slender else axes[:1]:
            axis.set_ylabel("z [mm]")
        figure.suptitle(f"{symbol} at {snapshots.pressures_kpa[-1]:g} kPa on the deformed shape")
        return figure

    return build


def _range(values: NDArray[np.float64]) -> str:
    return f"{values.min():.3g} … {values.max():.3g}".replace("-", "−")


def _base_lines(comparison: Comparison, highlights: NDArray[np.int64]) -> Callable[[], Figure]:
    """Deformed base lines at several pressures (the paper's Figs. 6 and 8)."""

    def build() -> Figure:
        from matplotlib import colormaps

        figure, axis = _new(1, 1, 6.5, 5)
        colours = colormaps["viridis"](np.linspace(0, 0.85, len(highlights)))
        for snapshot, colour in zip(highlights, colours, strict=True):
            fem, surrogate = comparison.base_lines_mm(int(snapshot))
            axis.plot(*fem.T, color=colour, linewidth=3, alpha=0.45)
            kpa = comparison.snapshots.pressures_kpa[snapshot]
            axis.plot(*surrogate.T, color=colour, linestyle="--", label=f"{kpa:g} kPa")
        axis.plot([], [], color="0.3", linewidth=3, alpha=0.45, label="FEM")
        axis.plot([], [], color="0.3", linestyle="--", label="surrogate")
        axis.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", title="Deformed base line")
        axis.set_adjustable("datalim")  # a finger that bends little would leave a strip
        axis.legend(loc="center left", bbox_to_anchor=(1, 0.5))
        return figure

    return build


def _mse_over_pressure(comparison: Comparison) -> Callable[[], Figure]:
    """Error of each snapshot in mm, and in the paper's mm²; pressures trained on are marked (the paper's Fig. 7)."""

    def build() -> Figure:
        rows = comparison.by_pressure()
        kpa = np.array([row["kpa"] for row in rows])
        figure, axis = _new(1, 1, 6.5, 4)
        for component, line in zip(comparison.snapshots.domain.axes, ("-", "--", ":"), strict=False):
            axis.semilogy(kpa, [row[f"mse_{component}_mm2"] ** 0.5 for row in rows], line, label=f"$u_{component}$")
        _mark_training(axis, kpa, comparison.seen_snapshots())
        axis.set(xlabel="pressure [kPa]", ylabel="RMS error over unseen points [mm]", xlim=(0, kpa[-1]))
        axis.secondary_yaxis("right", functions=(np.square, np.sqrt)).set_ylabel("mean squared error [mm²]")
        axis.set_title("Error over pressure")
        axis.grid(alpha=0.3)
        axis.legend()
        return figure

    return build


def _mark_training(axis: Axes, kpa: NDArray[np.float64], seen: NDArray[np.bool_]) -> None:
    """Mark at the lower edge each run of snapshots that gave training points, half a step beyond its ends."""
    half = np.diff(kpa).min() / 2 if len(kpa) > 1 else 1.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(int)))
    for number, (start, stop) in enumerate(edges.reshape(-1, 2)):
        label = "trained on" if number == 0 else None
        span = kpa[start] - half, kpa[stop - 1] + half
        axis.axvspan(*span, ymax=0.03, color=TRAINED, lw=0, zorder=0, label=label)


def _loss_history(history: list[dict[str, float]], units: Mapping[str, str]) -> Callable[[], Figure]:
    """Raw and weighted terms of the loss and their shares of the gradient."""

    def build() -> Figure:
        names = [key.removeprefix("raw/") for key in history[-1] if key.startswith("raw/")]
        seconds = [entry["seconds"] for entry in history]
        figure, axes = _new(1, 3, 13, 4, sharex=True)
        panels = (("raw", "value of the term"), ("weighted", "weight × value"), ("share", "share of the gradient norm"))
        for axis, (key, label) in zip(axes, panels, strict=True):
            for name in names:
                axis.plot(
                    seconds,
                    [entry[f"{key}/{name}"] for entry in history],
                    label=f"{name} [{units[name]}]" if units.get(name) else name,
                )
            axis.set(xlabel="training time [s]", ylabel=label)
            axis.grid(alpha=0.3)
            if key == "share":
                axis.set_ylim(0, 1)
            elif any(entry[f"{key}/{name}"] > 0 for entry in history for name in names):
                axis.set_yscale("log")
        axes[0].legend()
        figure.suptitle("Loss history")
        return figure

    return build
