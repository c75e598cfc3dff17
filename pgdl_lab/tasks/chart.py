"""Task `chart`: error against time of every method that fits the scene, beside a converged reference."""

import csv
import json
import logging
import math
from dataclasses import asdict, replace
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pgdl_lab.core import paths
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe, settings_of
from pgdl_lab.studies.chart.bench import Bench
from pgdl_lab.studies.chart.figure import draw
from pgdl_lab.studies.chart.methods import FINITE_ELEMENTS, all_points
from pgdl_lab.studies.chart.page import write_page
from pgdl_lab.studies.chart.point import Point, pareto
from pgdl_lab.studies.chart.settings import ChartSettings
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)

WIDTH = 170  # of the table
QUICK = Observation(snapshots=20, points=800)
QUICK_SHARE = 0.05  # of the points that are trained on


def run(job: Job) -> list[Point]:
    """Measure what was not measured before and write chart.csv, chart.json, chart.html and figures/chart.png.

    Raises
    ------
    InputError
        When a setting is outside its limits, or the scene has no converged reference.
    SimulationStopped
        When the finger cannot bear the highest pressure.
    """
    settings = chart_settings(job.config)
    experiment = job.experiment
    experiment.observation.require_face("task=chart")
    if job.config.quick:
        settings = settings.quick()
        fem: Any = experiment.fem
        split = replace(experiment.split, points=int(QUICK_SHARE * QUICK.snapshots * QUICK.points))
        coarse = replace(fem, edge_mm=2 * fem.edge_mm) if hasattr(fem, "edge_mm") else fem
        experiment = replace(experiment, observation=QUICK, split=split, fem=coarse)
    bench = Bench(experiment, settings, paths.RUNS)
    title = _title(bench)
    points: list[Point] = []
    told: set[str] = set()
    for point, found in all_points(bench):
        points.append(point)
        for sentence in point.warnings if found else ():  # others have been told as the point was measured
            if sentence not in told:
                _log.warning("%s: %s", point.label, sentence)
        told.update(point.warnings)
        said = (
            point.failed or f"{point.total.rms_mm:.3g} mm RMS, {point.query_ms:.3g} ms" if point.total else point.failed
        )
        _log.info("%s: %s%s", point.label, said, " (measured before)" if found else "")
        _write(job, bench, points, title)
    draw(points, bench.reference.uncertainty, title, settings.queries, job.folder / "figures" / "chart.png")
    Console(width=WIDTH).print(_table(points, bench))
    _log.info("The chart is in %s: chart.html, chart.csv, chart.json, figures/chart.png", job.folder)
    return points


def chart_settings(config: DictConfig) -> ChartSettings:
    """Settings of the chart, checked; raises InputError."""
    if not isinstance(config.quick, bool):
        raise InputError(f"quick is {config.quick!r}; it must be true or false.")
    given: Any = OmegaConf.to_container(config.chart)
    return settings_of(ChartSettings, "chart", given)


def _title(bench: Bench) -> str:
    experiment, reference = bench.experiment, bench.reference
    finger, split = describe(experiment.finger)["name"], describe(experiment.split)["name"]
    return (
        f"{finger}, split {split}, {experiment.split.points:,} points, data of {bench.data_name.rsplit('-', 1)[0]}; "
        f"reference from edges of {reference.edges_mm[0]:g} and {reference.edges_mm[1]:g} mm, "
        f"± {reference.uncertainty.rms_mm:.2g} mm RMS"
    )


def _write(job: Job, bench: Bench, points: list[Point], title: str) -> None:
    queries, solver = bench.settings.queries, _solver(points)
    rows = [point.row() | _paid(point, queries, solver) for point in points]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with replacing(job.folder / "chart.csv") as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
    uncertainty = bench.reference.uncertainty
    content = {"title": title, "uncertainty": asdict(uncertainty), "queries": queries, "points": rows}
    with replacing(job.folder / "chart.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")
    write_page(points, uncertainty, title, queries, job.folder / "chart.html")


def _paid(point: Point, queries: int, solver: Point | None) -> dict[str, Any]:
    """Time from end to end [s], and the number of queries from which the point takes less of it than `solver`."""
    if point.total is None:
        return {}
    even = point.break_even(solver) if solver and point.kind != FINITE_ELEMENTS else math.inf
    return {"end_to_end_s": point.end_to_end_s(queries), "break_even_queries": even if math.isfinite(even) else None}


def _table(points: list[Point], bench: Bench) -> Table:
    queries = bench.settings.queries
    fronts = {
        "query": pareto(points, lambda point: point.query_ms),
        f"{queries:,}": pareto(points, lambda point: point.end_to_end_s(queries)),
    }
    solver = _solver(points)
    table = Table(
        title=f"RMS errors; break-even: queries from which it is quicker than {solver.label if solver else '–'}"
    )
    for heading in ("method", "total [mm]", "discretisation", "surrogate", "largest", "simulate [s]", "train [s]",
                    "query [ms]", f"{queries:,} queries [s]", "break-even", "on the front"):  # fmt: skip
        table.add_column(Text(heading), justify="left" if heading == "method" else "right")
    for point in points:
        if point.total is None:
            table.add_row(Text(point.label), *[""] * 9, Text(point.failed[:60]))
            continue
        parts = (f"{part.rms_mm:.2g}" if part else "–" for part in (point.discretisation, point.surrogate))
        even = _paid(point, queries, solver)["break_even_queries"]
        times = point.simulate_s, point.train_s, point.query_ms, point.end_to_end_s(queries)
        table.add_row(
            Text(point.label), f"{point.total.rms_mm:.3g}", *parts, f"{point.total.largest_mm:.2g}",
            *(f"{float(f'{time:.3g}'):,g}" for time in times), "–" if even is None else f"{even:g}",
            ", ".join(name for name, front in fronts.items() if point in front),
        )  # fmt: skip
    return table


def _solver(points: list[Point]) -> Point | None:
    """The quickest finite-element model that errs no more than the best surrogate by half."""
    learnt = [point.total.rms_mm for point in points if point.total and point.kind != FINITE_ELEMENTS]
    good = [
        point for point in points
        if point.kind == FINITE_ELEMENTS and point.total and learnt and point.total.rms_mm <= 1.5 * min(learnt)
    ]  # fmt: skip
    return min(good, key=lambda point: point.query_ms, default=None)
