"""The methods of a chart: every registered finite-element model and surrogate, and the data themselves as a table."""

from collections.abc import Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core import sources
from pgdl_lab.core.registry import describe, names, plugin
from pgdl_lab.learning.settings import TrainerSettings
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.running.cache import simulate, snapshot_path
from pgdl_lab.running.composing import experiment
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.chart.bench import Bench, without_estimate
from pgdl_lab.studies.chart.point import Point
from pgdl_lab.studies.chart.settings import ChartSettings

FINITE_ELEMENTS, SURROGATE, TABLE = "finite elements", "surrogate", "table"
FINER = 4.0  # at least so many times as long takes a mesh with half the edges


def all_points(bench: Bench) -> Iterator[tuple[Point, bool]]:
    """Points of all methods, one after the other; and whether each was found in the store."""
    yield from _finite_elements(bench)
    yield from _references(bench)
    yield _table(bench)
    for how in _learners(bench):
        yield _surrogate(bench, *how)


def _finite_elements(bench: Bench) -> Iterator[tuple[Point, bool]]:
    for name in names("fem"):
        previous: tuple[float, float] | None = None  # edge and time of the mesh before
        for fem in _meshes(name, bench.settings):
            edge, label = getattr(fem, "edge_mm", None), _label(fem)
            if previous and edge and previous[1] * FINER ** np.log2(previous[0] / edge) > bench.settings.longest_s:
                yield (
                    Point(label, FINITE_ELEMENTS, failed=f"left out: longer than {bench.settings.longest_s:g} s"),
                    True,
                )
                continue
            yield (found := _solved(bench, fem, label))
            if edge and not found[0].failed:
                previous = edge, 1e-3 * found[0].query_ms


def _meshes(name: str, settings: ChartSettings) -> list[Fem]:
    """The registered model of that name on all its meshes, the coarsest first."""
    fem: Any = without_estimate(plugin("fem", name)())
    known = {field.name for field in fields(fem)}
    if "timeout_s" in known:
        fem = replace(fem, timeout_s=settings.longest_s)
    if "edge_mm" not in known:
        return [fem]
    return [replace(fem, edge_mm=factor * fem.edge_mm) for factor in sorted(settings.meshes, reverse=True)]


def _label(fem: Fem) -> str:
    edge = getattr(fem, "edge_mm", None)
    return f"{describe(fem)['name']}" + (f", {edge:g} mm" if edge else "")


def _solved(bench: Bench, fem: Fem, label: str) -> tuple[Point, bool]:
    finger, judged = bench.experiment.finger, bench.settings.judgement(bench.experiment.observation)

    def measure() -> Point:
        snapshots, _, _ = simulate(finger, fem, judged, bench.folder / "snapshots")
        query_ms = 1e3 * snapshots.provenance["seconds"]
        errors = bench.reference.errors(snapshots.displacements)
        return Point(label, FINITE_ELEMENTS, query_ms=query_ms, tip_ms=query_ms, total=errors, discretisation=errors,
                     warnings=snapshots.warnings)  # fmt: skip

    return bench.measured(label, FINITE_ELEMENTS, snapshot_path(Path(), finger, fem, judged).name, measure)


def _references(bench: Bench) -> Iterator[tuple[Point, bool]]:
    """The finer of the two meshes that the reference is extrapolated from."""
    fine, edge = bench.reference.fine, bench.reference.edges_mm[1]
    query_ms, errors = 1e3 * fine.provenance["seconds"], bench.reference.errors(fine.displacements)
    label = f"{bench.settings.reference['name']}, {edge:g} mm, for the reference"
    yield (
        Point(
            label, FINITE_ELEMENTS, 0.0, 0.0, query_ms, query_ms, errors, errors, warnings=bench.reference.fine.warnings
        ),
        True,
    )


def _table(bench: Bench) -> tuple[Point, bool]:
    """The data as they are, with a cubic spline in the pressure through all snapshots but the judged ones within."""

    def measure() -> Point:
        from scipy.interpolate import CubicSpline

        data, split = bench.data, bench.experiment.split
        given = split.seen(data.cases).copy()
        given[np.setdiff1d(bench.judged, [len(given) - 1])] = False
        spline = CubicSpline(data.pressures_kpa[given], data.displacements[given])
        place = {point.tobytes(): number for number, point in enumerate(data.domain.points_mm)}

        def predict(points: NDArray[np.float64], kpa: float) -> Any:
            return spline(kpa) if len(points) > 1 else spline(kpa)[[place[points[0].tobytes()]]]

        seen = np.broadcast_to(given[:, None], data.displacements.shape[:2])
        return bench.judge("table of snapshots", TABLE, 0.0, predict, seen)

    return bench.measured("table of snapshots", TABLE, [bench.data_name, describe(bench.experiment.split)], measure)


def _learners(bench: Bench) -> Iterator[tuple[str, Experiment]]:
    settings, own = bench.settings, bench.experiment
    for name in names("model"):
        limited = _limited(own.trainer, settings.train_s)
        yield name, replace(own, model=plugin("model", name)(), trainer=limited)
    for protocol in settings.protocols:
        how = experiment([f"experiment={protocol}"])
        for budget_s in settings.protocol_s:
            yield f"{protocol}, {budget_s:g} s", replace(how, trainer=_limited(how.trainer, budget_s))


def _limited(trainer: TrainerSettings, seconds: float) -> TrainerSettings:
    return replace(trainer, max_time=f"{min(seconds, trainer.max_seconds):g}")


def _surrogate(bench: Bench, label: str, how: Experiment) -> tuple[Point, bool]:
    own = bench.experiment
    trainer = {key: value for key, value in vars(how.trainer).items() if key not in ("progress", "log_every_s")}
    key = [
        bench.data_name, describe(how.model), [describe(loss) for loss in how.loss.values()], trainer,
        vars(how.optimizer), vars(how.balancing), describe(own.split), own.seed,
        sources.digest(type(part) for part in (how.model, own.split, *how.loss.values())),
    ]  # fmt: skip

    def measure() -> Point:
        surrogate, seconds = bench.trained(how)
        seen = np.zeros(bench.data.displacements.shape[:2], dtype=bool)
        seen.flat[bench.train] = True
        return bench.judge(label, SURROGATE, seconds, partial(surrogate.predict, beyond=True), seen)

    return bench.measured(label, SURROGATE, key, measure)
