"""The closing table in the terminal: our figures beside the paper's."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Group
from rich.table import Table
from rich.text import Text

from pgdl_lab.assessment.paper import Published, published


def closing_table(metrics: dict[str, Any], highlights: NDArray[np.int64]) -> Group:
    """Tables of the errors at the highlighted snapshots and of the extremes at the highest pressure.

    Parameters
    ----------
    metrics
        The content of metrics.json.
    highlights
        Indices of the snapshots that are listed.
    """
    paper = published(metrics["finger"], metrics["split"])
    return Group(_errors(metrics, highlights, paper), _extremes(metrics, paper), _times(metrics))


def _errors(metrics: dict[str, Any], highlights: NDArray[np.int64], paper: Published) -> Table:
    scene = f"{metrics['finger']}, split {metrics['split']}, model {metrics['model']}"
    table = Table(title=f"{scene}: MSE over unseen points")
    for heading in ("pressure [kPa]", "trained on", "x [mm²]", "paper", "z [mm²]", "paper", "max |error| [mm]"):
        table.add_column(Text(heading), justify="right")  # as text: units in brackets would be read as markup
    highest = metrics["by_pressure"][-1]["kpa"]
    for snapshot in highlights:
        row = metrics["by_pressure"][snapshot]
        share = row["kpa"] / highest
        theirs = next((text for known, text in paper.mse_mm2.items() if abs(share - known) < 5e-3), ("–", "–"))
        table.add_row(
            f"{row['kpa']:g}", "yes" if row["seen"] else "no",
            f"{row['mse_x_mm2']:.2e}", theirs[0], f"{row['mse_z_mm2']:.2e}", theirs[1], f"{row['max_abs_mm']:.3g}",
        )  # fmt: skip
    mse, most = metrics["mse_mm2"], max(row["max_abs_mm"] for row in metrics["by_pressure"])
    table.add_section()
    table.add_row("all", "", f"{mse['x']:.2e}", "–", f"{mse['z']:.2e}", "–", f"{most:.3g}")
    return table


def _extremes(metrics: dict[str, Any], paper: Published) -> Table:
    table = Table(title=f"Displacement at {metrics['by_pressure'][-1]['kpa']:g} kPa, least and greatest")
    for heading in ("", "FEM [mm]", "paper's FEA [mm]", "surrogate [mm]", "paper's PGDL [mm]"):
        table.add_column(Text(heading), justify="right")
    ours = metrics["extremes_mm"]
    for axis in "xz":
        table.add_row(
            f"u_{axis}",
            _range(ours["fem"][axis]), _range(paper.fem_mm.get(axis)),
            _range(ours["surrogate"][axis]), _range(paper.surrogate_mm.get(axis)),
        )  # fmt: skip
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
