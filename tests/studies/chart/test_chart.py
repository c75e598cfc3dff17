import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pgdl_lab.assessment import latency
from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.studies.chart import methods
from pgdl_lab.studies.chart.figure import _missing, draw
from pgdl_lab.studies.chart.labels import place
from pgdl_lab.studies.chart.page import write_page
from pgdl_lab.studies.chart.point import Point, pareto
from pgdl_lab.studies.chart.reference import Errors, Reference, find_reference
from pgdl_lab.studies.chart.settings import ChartSettings
from pgdl_lab.tasks import chart
from tests.fingers import pneunet
from tests.studies.chart import scene

FACTOR = 1.5  # by which an error may grow: other machines round otherwise, and trainings carry that on
NOTHING_MM = 1e-6  # errors below this are not compared
EXACT = np.array([[[1.0, -2.0], [3.0, 0.5]]])


def errors(size: float) -> Errors:
    return Errors(size, size, size)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("guard")


@pytest.fixture(scope="module")
def measured(folder: Path, request: pytest.FixtureRequest) -> dict[str, dict[str, float]]:
    before = latency.SECONDS, latency.LEAST_REPEATS
    request.addfinalizer(lambda: (setattr(latency, "SECONDS", before[0]), setattr(latency, "LEAST_REPEATS", before[1])))
    return scene.errors(folder)


def grown(measured: dict[str, dict[str, float]], stored: dict[str, dict[str, float]]) -> dict[tuple[str, str], Any]:
    """Errors that are more than `FACTOR` times those stored, and these."""
    return {
        (label, part): (error, stored[label][part])
        for label, parts in measured.items()
        for part, error in parts.items()
        if label in stored and error > max(FACTOR * stored[label][part], NOTHING_MM)
    }


def test_no_method_errs_more_than_it_did(
    measured: dict[str, dict[str, float]], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = json.loads(scene.STORED.read_text())
    with capsys.disabled():  # times are told, not judged
        print()
        for point, _ in methods.all_points(scene.bench(folder)):
            print(f"  {point.label}: simulated {point.simulate_s:.2g} s, trained {point.train_s:.2g} s, ", end="")
            print(f"a query {point.query_ms:,.2f} ms")
    assert not grown(measured, stored)
    assert {label for label in stored if "calculix" not in label} <= measured.keys()


def test_the_guard_sees_an_error_that_has_grown() -> None:
    stored = json.loads(scene.STORED.read_text())
    assert not grown(stored, stored)
    worse = {**stored, "pod": {**stored["pod"], "surrogate": 1.01 * FACTOR * stored["pod"]["surrogate"]}}
    assert list(grown(worse, stored)) == [("pod", "surrogate")]


def test_every_registered_method_is_there_and_measured_once(
    measured: dict[str, dict[str, float]], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert set(registry.names("model")) <= measured.keys()
    assert {label.partition(",")[0] for label in measured} >= {*registry.names("fem")}
    bench = scene.bench(folder)
    again = {point.label: (found, point) for point, found in methods.all_points(bench)}
    assert all(found for found, _ in again.values())
    assert "fem=rod leaves out that walls stiffen" in again["rod, 6 mm"][1].row()["warnings"]  # told of what is stored

    pod: Any = registry.plugin("model", "pod")

    @dataclass(frozen=True)
    class Other(pod):
        degree: int = 3

    monkeypatch.setitem(registry._plugins["model"], "other", Other)
    Other.name = "other"
    latency.SECONDS, latency.LEAST_REPEATS = 0.0, 2
    (new,) = [point for point, found in methods.all_points(scene.bench(folder)) if not found]
    assert new.label == "other"
    assert new.surrogate and new.total and new.surrogate.rms_mm > 0


def test_a_failure_is_a_point() -> None:
    assert Point("it", "surrogate", failed="stopped at 32 kPa").row()["failed"] == "stopped at 32 kPa"
    assert pareto([Point("it", "surrogate", failed="stopped")], lambda point: point.query_ms) == []


def test_pareto_front() -> None:
    places = [(1, 5), (2, 6), (3, 4), (3, 2), (4, 2), (3.5, 2.01), (2.8, 2.015), (9, 1.99), (9, 1.5), (0.7, 5.04)]
    points = [Point(str(i), "surrogate", query_ms=t, total=errors(e)) for i, (t, e) in enumerate(places)]
    # what differs by less than can be told, 3 from 5 and 6, shares the front; 4 and 7 take clearly longer
    assert [point.label for point in pareto(points, lambda point: point.query_ms)] == ["9", "6", "3", "5", "8"]


def test_break_even() -> None:
    solver = Point("solid", "finite elements", query_ms=10_000)
    learnt = Point("pod", "surrogate", simulate_s=30, train_s=5, query_ms=1)
    count = learnt.break_even(solver)
    assert learnt.end_to_end_s(int(count)) <= solver.end_to_end_s(int(count))
    assert learnt.end_to_end_s(int(count) - 1) > solver.end_to_end_s(int(count) - 1)
    assert Point("slow", "surrogate", train_s=1, query_ms=20_000).break_even(solver) == np.inf


def simulated(of_edge: Callable[[float], float], edge: float = 2.0) -> Reference:
    """The reference from meshes whose displacements have a relative error."""

    def mesh(length: float) -> Any:
        domain = SimpleNamespace(base=np.array([0, 1]))
        return SimpleNamespace(displacements=EXACT * (1 + of_edge(length)), domain=domain)

    return Reference(mesh(2 * edge), mesh(edge), mesh(edge / 2), (edge, edge / 2), (Path(), Path()))


@pytest.mark.parametrize("order", [2, 3])
def test_the_reference_is_extrapolated_with_its_order(order: int) -> None:
    reference = replace(simulated(lambda length: 0.1 * length**order), order=order)
    np.testing.assert_allclose(reference.displacements, EXACT, rtol=1e-14)
    assert reference.errors(reference.fine.displacements).tip_mm < reference.uncertainty.tip_mm


@pytest.mark.parametrize(("order", "left"), [(3, 1 / 2), (2, 1 / 2), (1.5, 0.547), (1, 1.0), (0.2, 1.0)])
def test_the_reference_is_as_sure_as_its_meshes_have_come_nearer(order: float, left: float) -> None:
    reference = simulated(lambda length: 0.1 * length**order)
    step = Errors.of(reference.fine.displacements - reference.coarse.displacements, 1)
    assert reference.uncertainty.rms_mm == pytest.approx(left * step.rms_mm, rel=1e-3)
    if order >= 1:
        assert reference.errors(EXACT).rms_mm < reference.uncertainty.rms_mm


def test_a_reference_that_changes_sides_is_not_sure() -> None:
    reference = simulated({4.0: 0.03, 2.0: -0.01, 1.0: 0.02}.__getitem__)
    assert reference.errors(EXACT).rms_mm < reference.uncertainty.rms_mm
    assert replace(reference, coarser=None).uncertainty == reference.uncertainty


def test_errors_count_the_points_that_are_asked_for() -> None:
    difference = np.zeros((1, 3, 2))
    difference[0, 1] = 3, 4
    found = Errors.of(difference, 0, np.array([[True, True, False]]))
    assert (found.rms_mm, found.largest_mm, found.tip_mm) == (pytest.approx(np.sqrt(12.5)), 5, 0)


def test_the_page_holds_everything_and_nothing_breaks_out_of_it(tmp_path: Path) -> None:
    point = Point("</script><b>", "surrogate", query_ms=1, total=errors(0.5))
    write_page([point], errors(0.1), "a <title>", 7, tmp_path / "chart.html")
    text = (tmp_path / "chart.html").read_text()
    assert text.count("</script>") == 1
    assert "a &lt;title&gt;" in text
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")
    (found,) = re.findall(r"const data = (.*?), colours", text)
    assert json.loads(found)["points"][0]["label"] == point.label


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"queries": 0}, "chart.queries is 0"),
        ({"meshes": [0.0]}, "chart.meshes"),
        ({"train_s": -1.0}, "chart.train_s is -1"),
        ({"reference": {}}, "names no finite-element model"),
    ],
)
def test_bad_settings_are_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        replace(scene.SETTINGS, **changes)


def test_a_reference_needs_an_edge_to_halve(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs an edge_mm"):
        find_reference(pneunet(), {"name": "solid"}, Observation(2, 400), tmp_path)


@pytest.mark.parametrize(("element", "order"), [("hex27_p1", 3), ("hex27_p0", 2)])
def test_a_reference_has_the_order_of_its_element(element: str, order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(finger: Any, fem: Any, *rest: Any) -> Any:
        return SimpleNamespace(provenance={"element": fem.element, "mesh": fem.edge_mm}), Path(), False

    monkeypatch.setattr("pgdl_lab.studies.chart.reference.simulate", simulate)
    asked = {"name": "solid", "edge_mm": 6.0, "element": element}
    assert find_reference(pneunet(), asked, Observation(1, 400), Path()).order == order


def test_judged_pressures_divide_those_observed() -> None:
    settings = ChartSettings(reference={"name": "solid", "edge_mm": 3.0})
    assert settings.judgement(Observation(snapshots=12)).snapshots == 4
    assert settings.judgement(Observation(snapshots=7)).snapshots == 1
    assert settings.quick().reference["edge_mm"] == 6.0


def test_labels_meet_neither_each_other_nor_points_and_stay_inside() -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots()
    places = [(1.0 + 0.002 * i, 1.0) for i in range(6)] + [(0.0, 0.0), (3.0, 1.2), (3.0, 0.0)]
    panel.plot(*zip(*places, strict=True), "o")
    panel.margins(0.15)
    labels = [panel.text(*at, f"a method called {i}", fontsize=8) for i, at in enumerate(places)]
    figure.canvas.draw()
    place(panel, places, labels, [((0.0, 0.0), (0.0, 1.0))])
    boxes = [label.get_window_extent() for label in labels]
    pixels = panel.transData.transform(places)
    for one, box in enumerate(boxes):
        assert panel.get_window_extent().containsx(box.x0) and panel.get_window_extent().containsx(box.x1)
        assert panel.get_window_extent().containsy(box.y0) and panel.get_window_extent().containsy(box.y1)
        assert not any(box.overlaps(other) for other in boxes[:one])
        assert not box.count_contains(pixels)
    plt.close(figure)


def test_the_figure_names_what_is_not_shown(tmp_path: Path) -> None:
    points = [Point("pod", "surrogate", query_ms=1, total=errors(0.5)), Point("it", "table", failed="stopped: at 3")]
    assert _missing(points) == "Not shown: it: stopped"
    draw(points, errors(0.1), "a title", 10, tmp_path / "chart.png")
    assert (tmp_path / "chart.png").stat().st_size > 1000


def test_table_and_records_hold_every_method_and_when_it_has_paid(tmp_path: Path) -> None:
    points = [
        Point("solid", "finite elements", query_ms=10_000.0, tip_ms=10_000.0, total=errors(0.1)),
        Point("pod", "surrogate", simulate_s=30.0, train_s=5.0, query_ms=1.0, total=errors(0.1)),
        Point("calculix", "finite elements", failed="stopped"),
    ]
    settings = SimpleNamespace(queries=100)
    bench: Any = SimpleNamespace(settings=settings, reference=SimpleNamespace(uncertainty=errors(0.01)))
    job: Any = SimpleNamespace(folder=tmp_path)
    chart._write(job, bench, points, "a title")
    with (tmp_path / "chart.csv").open(newline="") as file:
        solid, pod, calculix = csv.DictReader(file)
    assert (solid["break_even_queries"], pod["break_even_queries"], calculix["failed"]) == ("", "4", "stopped")
    assert float(pod["end_to_end_s"]) == pytest.approx(35.1)
    stored = json.loads((tmp_path / "chart.json").read_text())
    assert [row["label"] for row in stored["points"]] == ["solid", "pod", "calculix"]
    assert (tmp_path / "chart.html").is_file()
