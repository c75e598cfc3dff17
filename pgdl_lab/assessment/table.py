"""The closing table in the terminal: our figures, and beside those of the paper's fingers the paper's."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Group
from rich.table import Table
from rich.text import Text

from pgdl_lab.assessment.paper import Published


def closing_table(metrics: dict[str, Any], highlights: NDArray[np.int64], paper: Published) -> Group:
    """Tables of both errors, of that at the highlighted snapshots beside a yardstick's, of extremes and of times.

    Parameters
    ----------
    metrics
        The content of metrics.json.
    highlights
        Indices of the snapshots that are listed.
    paper
        The paper's figures; where it has none there is no column for them.
    """
    beside = [_beside(metrics, highlights)] if metrics["yardstick"] or metrics["error_bar"] else []
    parts = [
        _accuracy(metrics),
        _errors(metrics, highlights, paper),
        *beside,
        _residuals(metrics),
        _extremes(metrics, paper),
    ]
    return Group(*parts, _times(metrics))


def _accuracy(metrics: dict[str, Any]) -> Table:
    """How far the simulation is from a finer one, and the surrogate from the simulation."""
    title = "How far off: the surrogate from its simulation, the simulation from one on half the edges"
    table = Table(title=title)
    table.add_column("")
    for heading in ("RMS [mm]", "tip [mm]", "tip [%]", "largest [mm]"):
        table.add_column(Text(heading), justify="right")
    kinds = ("rms_mm", "tip_mm", "tip_percent", "largest_mm")
    ours, mesh = metrics["surrogate_error"], metrics["discretisation_error"]
    where = f"at {mesh['kpa']:.4g} kPa" if mesh else "not known"
    rows = {"surrogate, at unseen points": ours, f"simulation, {where}": mesh or {}}
    for what, error in rows.items():
        table.add_row(what, *("–" if error.get(kind) is None else f"{error[kind]:.2g}" for kind in kinds))
    return table


def _errors(metrics: dict[str, Any], highlights: NDArray[np.int64], paper: Published) -> Table:
    scene = f"{metrics['finger']}, split {metrics['split']}, model {metrics['model']}"
    table = Table(title=f"{scene}: MSE over unseen points")
    theirs = ["paper"] if paper.mse_mm2 else []
    of_errors = [heading for axis in metrics["mse_mm2"] for heading in (f"{axis} [mm²]", *theirs)]
    for heading in ("pressure [kPa]", "trained on", *of_errors, "max |error| [mm]"):
        table.add_column(Text(heading), justify="right")  # as text: units in brackets would be read as markup

    def add(kpa: str, seen: str, mse: list[float], most: float, known: tuple[str, ...] = ("–", "–")) -> None:
        texts = [f"{value:.2e}" for value in mse]
        if theirs:
            texts = [text for pair in zip(texts, known, strict=True) for text in pair]
        table.add_row(kpa, seen, *texts, f"{most:.3g}")

    highest = metrics["by_pressure"][-1]["kpa"]
    for snapshot in highlights:
        row = metrics["by_pressure"][snapshot]
        share = row["kpa"] / highest
        known = next((texts for each, texts in paper.mse_mm2.items() if abs(share - each) < 5e-3), ("–", "–"))
        mse = [row[f"mse_{axis}_mm2"] for axis in metrics["mse_mm2"]]
        add(f"{row['kpa']:g}", "yes" if row["seen"] else "no", mse, row["max_abs_mm"], known)
    table.add_section()
    most = max(row["max_abs_mm"] for row in metrics["by_pressure"])
    add("all", "", [*metrics["mse_mm2"].values()], most)
    return table


def _beside(metrics: dict[str, Any], highlights: NDArray[np.int64]) -> Table:
    """Share of the errors that the error bars cover, and the yardstick's mean squared errors."""
    yardstick, bars = metrics["yardstick"], metrics["error_bar"]
    title = [f"in its error bar (median {bars['median_mm']:.1e} mm)"] if bars else []
    title += [f"yardstick {yardstick['model']}, trained in {yardstick['seconds']:.1f} s"] if yardstick else []
    table = Table(title=f"The same points: {'; '.join(title)}")
    axes = [*metrics["mse_mm2"]]
    first, *others = (f"{axis} [mm²]" for axis in axes)
    for heading in ("pressure [kPa]", "in error bar", f"yardstick's {first}", *others, "max |error| [mm]"):
        table.add_column(Text(heading), justify="right")

    def add(kpa: str, covered: float | None, errors: list[Any]) -> None:
        *mse, most = errors or [None] * (len(axes) + 1)
        numbers = [*("–" if value is None else f"{value:.2e}" for value in mse), "–" if most is None else f"{most:.3g}"]
        table.add_row(kpa, "–" if covered is None else f"{covered:.1%}", *numbers)

    rows = yardstick["by_pressure"] if yardstick else []
    for snapshot in highlights:
        own = metrics["by_pressure"][snapshot]
        names = (*(f"mse_{axis}_mm2" for axis in axes), "max_abs_mm")
        add(f"{own['kpa']:g}", own["covered"], [rows[snapshot][name] for name in names] if rows else [])
    table.add_section()
    covered = sum(bars[f"covered_{axis}"] for axis in axes) / len(axes) if bars else None
    most = max((row["max_abs_mm"] for row in rows), default=0.0)
    add("all", covered, [*yardstick["mse_mm2"].values(), most] if yardstick else [])
    return table


def _residuals(metrics: dict[str, Any]) -> Table:
    table = Table(title="Loss terms, unweighted, of whole fields at these pressures")
    for heading in ("", "FEM, the floor", "surrogate", "no displacement"):
        table.add_column(Text(heading), justify="right")
    for name, of in metrics["residuals"].items():
        unit = f" [{of['unit']}]" if of.get("unit") else ""
        table.add_row(Text(name + unit), *(f"{of[who]:.2e}" for who in ("fem", "surrogate", "rest")))
    return table


def _extremes(metrics: dict[str, Any], paper: Published) -> Table:
    table = Table(title=f"Displacement at {metrics['by_pressure'][-1]['kpa']:g} kPa, least and greatest")
    ours = metrics["extremes_mm"]
    columns: dict[str, Any] = {
        "FEM [mm]": ours["fem"],
        "paper's FEA [mm]": paper.fem_mm,
        "surrogate [mm]": ours["surrogate"],
        "paper's PGDL [mm]": paper.surrogate_mm,
    }
    shown = {heading: extremes for heading, extremes in columns.items() if extremes}
    for heading in ("", *shown):
        table.add_column(Text(heading), justify="right")
    for axis in ours["fem"]:
        table.add_row(f"u_{axis}", *(_range(extremes.get(axis)) for extremes in shown.values()))
    return table


def _range(pair: Any) -> str:
    return f"{pair[0]:.2f}, {pair[1]:.2f}" if pair else "–"


def _times(metrics: dict[str, Any]) -> Table:
    table = Table(title="Time")
    for heading in ("simulate [s]", "train [s]", "full field [ms]", "tip [ms]", "greatest base-line distance [mm]"):
        table.add_column(Text(heading), justify="right")
    seconds, latency = metrics["seconds"], metrics["latency_ms"]
    cached = " (cached)" if seconds.get("simulate_cached") else ""
    table.add_row(
        f"{seconds.get('simulate', 0):.1f}{cached}", f"{seconds.get('train', 0):.1f}",
        f"{latency['full_field']['median']:.2f}", f"{latency['tip']['median']:.3f}",
        f"{max(row['rms_distance_mm'] for row in metrics['curvature']):.3g}",
    )  # fmt: skip
    return table
