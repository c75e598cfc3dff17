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

from pgdl_lab.core.files import replacing
from pgdl_lab.running.metrics import numbers
from pgdl_lab.running.sweep import FAILURE, OVERRIDES

MESH_ERROR = "discretisation_error.tip_mm"
COMPARED = {
    "mse_mm2.x": "MSE x [mm²]",
    "mse_mm2.z": "MSE z [mm²]",
    MESH_ERROR: "mesh error [mm]",
    "seconds.simulate": "simulation [s]",
    "seconds.train": "training [s]",
    "latency_ms.full_field.median": "full field [ms]",
    "extremes_mm.fem.x.0": "least u_x [mm]",
    "extremes_mm.fem.z.0": "least u_z [mm]",
}
"""Metrics that are set side by side, and their headings."""
ACROSS = 4  # panels in a row of the figure
BORDER, BESIDE = 1, 3  # characters that a table and each of its columns take beside what they hold


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
    varied = _varied([row.settings for row in rows])
    columns = [key for key in COMPARED if any(key in row.metrics for row in rows)]
    differ = _varied([row.metrics for row in rows if row.metrics])
    differ = [key for key in columns if key in differ] or columns
    compared = [key for key in columns if key in differ or key == MESH_ERROR]
    path = folder / "comparison.csv"
    console = Console()
    console.print(_table(rows, varied, compared, console.width, path))
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["job", *varied, *columns, "error"])
        for row in rows:
            settings = [row.settings.get(name, "") for name in varied]
            writer.writerow([row.job, *settings, *(row.metrics.get(key, "") for key in columns), row.failure])
    return [path, _figure([row for row in rows if row.metrics], compared, folder / "comparison.png")]


def _varied(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names under which not all rows have the same."""
    names = sorted({name for row in rows for name in row})
    return [name for name in names if len({row.get(name) for row in rows}) > 1]


def _row(job: Path) -> _Row:
    typed: list[str] = json.loads((job / OVERRIDES).read_text(encoding="utf-8"))
    settings = {key: value for key, _, value in (override.partition("=") for override in typed)}
    metrics, failure = job / "metrics.json", job / FAILURE
    found: Any = json.loads(metrics.read_text(encoding="utf-8")) if metrics.is_file() else {}
    problem = failure.read_text(encoding="utf-8") if failure.is_file() else ""
    return _Row(job.name, settings, dict(numbers(found)), problem)


def _table(rows: Sequence[_Row], varied: Sequence[str], columns: Sequence[str], width: int, path: Path) -> Table:
    """Jobs, settings and as many metrics as `width` has room for; the others are left to the file at `path`."""
    settings = [[f"{name}={row.settings[name]}" for name in varied if name in row.settings] for row in rows]
    longest = max((len(setting) for each in settings for setting in each), default=0)
    job = max(len("job"), *(len(row.job) for row in rows))
    room = width - BORDER - (job + BESIDE) - (min(max(longest, len("settings")), width // 3) + BESIDE)
    cells = {key: [_cell(row, key) for row in rows] for key in columns}
    shown: list[str] = []
    for key in columns:
        room -= max(map(len, [*cells[key], *_heading(key).split("\n")])) + BESIDE
        if room < 0 and shown:
            break
        shown.append(key)
    table = Table(title="The runs side by side", caption=f"More is in {path}." if len(shown) < len(columns) else None)
    table.add_column("job", justify="right", no_wrap=True)
    table.add_column("settings", overflow="fold")
    for key in shown:
        table.add_column(Text(_heading(key)), justify="right", no_wrap=True)
    for number, row in enumerate(rows):
        table.add_row(row.job, Text("  ".join(settings[number])), *(cells[key][number] for key in shown))
    return table


def _heading(key: str) -> str:
    return COMPARED[key].replace(" [", "\n[")


def _cell(row: _Row, key: str) -> str:
    if key in row.metrics:
        return f"{row.metrics[key]:.3g}"
    return "failed" if row.failure else "–"


def _figure(rows: Sequence[_Row], columns: Sequence[str], path: Path) -> Path:
    """One panel of bars per metric, as many in a row as fit."""
    import matplotlib
    from matplotlib.figure import Figure

    from pgdl_lab.assessment.figures import STYLE

    varied = _varied([row.settings for row in rows])
    labels = [" ".join(row.settings.get(name, "–") for name in varied) or row.job for row in rows]
    across = min(len(columns), ACROSS)
    down = -(-len(columns) // across)
    with matplotlib.rc_context(STYLE), replacing(path) as temporary:
        size = (2.7 * across + 1.5, down * (0.35 * len(rows) + 1.2))
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(down, across, sharey=True, squeeze=False).ravel()
        for axis in axes[len(columns) :]:
            axis.remove()
        for axis, key in zip(axes, columns, strict=False):
            values = [row.metrics.get(key, 0.0) for row in rows]
            axis.barh(range(len(rows)), values)
            if key.startswith("mse") and min(values) > 0 and max(values) > 20 * min(values):
                axis.set_xscale("log")
            axis.set_xlabel(COMPARED[key])
        axes[0].set_yticks(range(len(rows)), labels)
        axes[0].invert_yaxis()
        figure.savefig(temporary, format="png")
    return path
