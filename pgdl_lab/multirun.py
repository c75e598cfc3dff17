"""A multirun without a search: its jobs side by side, as a table, a file and a figure."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from pgdl_lab.files import replacing
from pgdl_lab.search.objectives import numbers
from pgdl_lab.sweep import FAILURE, OVERRIDES

COMPARED = {
    "mse_mm2.x": "MSE x [mm²]",
    "mse_mm2.z": "MSE z [mm²]",
    "seconds.simulate": "simulation [s]",
    "seconds.train": "training [s]",
    "latency_ms.full_field.median": "full field [ms]",
    "extremes_mm.fem.x.0": "least u_x [mm]",
    "extremes_mm.fem.z.0": "least u_z [mm]",
}
"""Metrics that are set side by side, and their headings."""


@dataclass(frozen=True)
class _Row:
    job: str
    settings: Mapping[str, str]
    metrics: Mapping[str, float]
    failure: str


def compare(folder: Path) -> list[Path]:
    """Show the jobs of the multirun in `folder` and write comparison.csv and comparison.png.

    Returns
    -------
    The files; none if fewer than two jobs have metrics.
    """
    jobs = sorted(folder.glob(f"*/{OVERRIDES}"), key=lambda file: (len(file.parent.name), file.parent.name))
    rows = [_row(file.parent) for file in jobs]
    if sum(bool(row.metrics) for row in rows) < 2:
        return []
    names = sorted({name for row in rows for name in row.settings})
    varied = [name for name in names if len({row.settings.get(name) for row in rows}) > 1]
    columns = [key for key in COMPARED if any(key in row.metrics for row in rows)]
    Console().print(_table(rows, varied, columns))
    path = folder / "comparison.csv"
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["job", *varied, *columns, "error"])
        for row in rows:
            settings = [row.settings.get(name, "") for name in varied]
            writer.writerow([row.job, *settings, *(row.metrics.get(key, "") for key in columns), row.failure])
    return [path, _figure(rows, varied, columns, folder / "comparison.png")]


def _row(job: Path) -> _Row:
    typed: list[str] = json.loads((job / OVERRIDES).read_text(encoding="utf-8"))
    settings = {key: value for key, _, value in (override.partition("=") for override in typed)}
    metrics, failure = job / "metrics.json", job / FAILURE
    found: Any = json.loads(metrics.read_text(encoding="utf-8")) if metrics.is_file() else {}
    problem = failure.read_text(encoding="utf-8") if failure.is_file() else ""
    return _Row(job.name, settings, dict(numbers(found)), problem)


def _table(rows: Sequence[_Row], varied: Sequence[str], columns: Sequence[str]) -> Table:
    table = Table(title="The runs side by side")
    for heading in ("job", *varied, *(COMPARED[key] for key in columns)):
        table.add_column(heading, justify="right", overflow="fold")
    for row in rows:
        figures = [f"{row.metrics[key]:.3g}" if key in row.metrics else "–" for key in columns]
        if row.failure:
            figures[0] = "failed"
        table.add_row(row.job, *(Text(row.settings.get(name, "–")) for name in varied), *figures)
    return table


def _figure(rows: Sequence[_Row], varied: Sequence[str], columns: Sequence[str], path: Path) -> Path:
    """One panel of bars per metric."""
    import matplotlib
    from matplotlib.figure import Figure

    from pgdl_lab.assessment.figures import STYLE

    shown = [row for row in rows if row.metrics]
    labels = [" ".join(row.settings.get(name, "–") for name in varied) or row.job for row in shown]
    with matplotlib.rc_context(STYLE), replacing(path) as temporary:
        figure = Figure(figsize=(3.2 * len(columns) + 1, 0.4 * len(shown) + 1.5), layout="constrained")
        axes = figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
        for axis, key in zip(axes, columns, strict=True):
            values = [row.metrics.get(key, 0.0) for row in shown]
            axis.barh(range(len(shown)), values)
            if key.startswith("mse") and min(values) > 0 and max(values) > 20 * min(values):
                axis.set_xscale("log")
            axis.set_xlabel(COMPARED[key])
        axes[0].set_yticks(range(len(shown)), labels)
        axes[0].invert_yaxis()
        figure.savefig(temporary, format="png")
    return path
