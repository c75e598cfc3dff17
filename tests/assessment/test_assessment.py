"""Metrics on data whose errors are known, and everything that an assessment writes."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from pgdl_lab.assessment import figures
from pgdl_lab.assessment.assess import Labels, assess
from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.assessment.paper import PUBLISHED, Published, comparable, published
from pgdl_lab.assessment.table import closing_table
from pgdl_lab.assessment.yardstick import measure
from pgdl_lab.core.dataset_file import DISPLACEMENT
from pgdl_lab.core.registry import discover, names, plugin
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.surrogate.curvature import mean_curvature_per_m, rms_distance_mm
from pgdl_lab.surrogate.probe import Probe
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.synthetic import MAX_KPA, bend
from tests.trainings import TRAIN, small, training

discover()
TERM = {"raw/data": 2.0, "weighted/data": 4.0, "share/data": 1.0}
NONE = np.empty(0, dtype=np.int64)
ENTRY = {"epoch": 1.0, "seconds": 1.0, "lr": 1e-3, "loss": 4.0, **TERM}


LABELS = Labels("pneunet", "solid", "random", "mlp", ["data"], {}, 0)


class Shifted(Surrogate):
    """The truth, off by (0.3, −0.1) mm."""

    def __init__(self) -> None:
        history = [ENTRY, {**ENTRY, "seconds": 2.0, "raw/data": 1.0}]
        super().__init__({"name": "mlp"}, Record({}, {}, history))

    def state(self) -> dict[str, NDArray[Any]]:
        return {}

    def probe(self, points_mm: NDArray[np.float64]) -> Probe:
        return Bent(points_mm)


class Bent(Probe):
    def __init__(self, points_mm: NDArray[np.float64]) -> None:
        self.points_mm = points_mm

    def value(self, kpa: float) -> NDArray[np.float64]:
        return bend(self.points_mm, kpa) + [0.3, -0.1]


def arc(angle: float, radius_mm: float) -> NDArray[np.float64]:
    """200 points on an arc that leaves the origin along x and turns by `angle` towards z."""
    t = np.linspace(0, angle, 200)
    return radius_mm * np.stack([np.sin(t), 1 - np.cos(t)], axis=1)


@pytest.mark.parametrize("angle", [0.1, 1.0, 3.0, 5.0])
def test_curvature_of_an_arc_is_one_over_its_radius(angle: float) -> None:
    assert mean_curvature_per_m(arc(angle, 40.0)) == pytest.approx(1000 / 40, rel=1e-3)
    assert mean_curvature_per_m(arc(angle, 40.0) * [1, -1]) == pytest.approx(-1000 / 40, rel=1e-3)


def test_curvature_of_a_straight_line_is_zero() -> None:
    assert mean_curvature_per_m(np.stack([np.linspace(0, 100, 50), np.zeros(50)], axis=1)) == pytest.approx(0, abs=1e-9)


def test_distance_of_shifted_lines_is_the_shift() -> None:
    assert rms_distance_mm(arc(1, 40), arc(1, 40) + [3.0, 4.0]) == pytest.approx(5)


def test_mse_counts_only_unseen_points() -> None:
    data = small()
    predicted = data.displacements + [0.3, -0.1]
    train = np.arange(0, data.displacements.size // 2, 7)
    flat = predicted.reshape(-1, 2)
    flat[train] += 100.0  # must not show
    comparison = Comparison(data, predicted, train)
    assert comparison.mse_mm2() == pytest.approx({"x": 0.09, "z": 0.01})
    assert all(row["max_abs_mm"] == pytest.approx(0.3) for row in comparison.by_pressure())


def test_points_that_a_search_selects_by_are_not_tested_on() -> None:
    data = small()
    predicted = data.displacements + [0.3, -0.1]
    selection = np.arange(3, data.displacements.size // 2, 7)
    predicted.reshape(-1, 2)[selection] += [0.7, 0.0]
    comparison = Comparison(data, predicted, np.arange(0, data.displacements.size // 2, 7), selection=selection)
    assert comparison.mse_mm2() == pytest.approx({"x": 0.09, "z": 0.01})
    assert comparison.selection_mm2() == pytest.approx({"x": 1.0, "z": 0.01})
    assert Comparison(data, predicted, TRAIN).selection_mm2() is None


def test_lengths_of_the_error_are_counted_over_unseen_points_and_at_the_tip() -> None:
    data = small()
    nodes, tip, off = len(data.domain.points_mm), data.domain.base[-1], np.zeros_like(data.displacements)
    off[..., 1] = 4.0
    off[:2, :, 0], off[2] = 100.0, [3.0, 0.0]  # two snapshots are trained on, a third is off by 3 along x
    off[:, tip] = [-6.0, 8.0]
    off[7, 5] = [5.0, -12.0]
    found = Comparison(data, data.displacements + off, np.arange(2 * nodes)).error()
    unseen = 18 * nodes
    squares = 17 * (nodes - 1) * 16 + (nodes - 1) * 9 + 18 * 100 + 169 - 16
    assert found["rms_mm"] == pytest.approx(np.sqrt(squares / unseen))
    assert found["largest_mm"] == pytest.approx(13) and found["tip_mm"] == pytest.approx(10)
    moved = max(np.hypot(*u[tip]) for u in data.displacements)
    assert found["tip_percent"] == pytest.approx(1000 / moved)
    still = replace(data, fields={DISPLACEMENT: np.zeros_like(data.displacements)})
    assert Comparison(still, off, NONE).error()["tip_percent"] is None


def test_bars_are_judged_by_the_unseen_points_they_cover() -> None:
    data = small()
    nodes = len(data.domain.points_mm)
    predicted = data.displacements + [0.3, -0.1]
    bars = np.full(predicted.shape[:2], 0.2)
    bars[:5], bars[5, : nodes // 2], bars[5, nodes // 2 :] = 9.0, 0.05, 0.4
    comparison = Comparison(data, predicted, np.arange(4 * nodes), bars)
    # of 16 snapshots one has bars of 9 mm, one of 0.05 and 0.4 mm, the others of 0.2 mm
    wide, narrow = nodes - nodes // 2, nodes // 2
    found = comparison.error_bar()
    assert found == pytest.approx({
        "covered_x": (nodes + wide) / (16 * nodes), "covered_z": 1 - narrow / (16 * nodes), "median_mm": 0.2
    })  # fmt: skip
    shares = [row["covered"] for row in comparison.by_pressure()]
    assert shares == pytest.approx([1.0] * 5 + [wide / nodes] + [0.5] * 14)
    without = Comparison(data, predicted, TRAIN)
    assert without.error_bar() is None and {row["covered"] for row in without.by_pressure()} == {None}


def test_errors_by_pressure_and_extremes_are_told_by_component() -> None:
    data = small()
    off = np.zeros_like(data.displacements)
    off[3, ::2], off[3, 1::2] = [1.0, -3.0], [-1.0, 2.0]
    comparison = Comparison(data, data.displacements + off, NONE)
    row, share = comparison.by_pressure()[3], len(data.domain.points_mm[::2]) / len(data.domain.points_mm)
    assert [row["mse_x_mm2"], row["mse_z_mm2"]] == pytest.approx([1.0, 9 * share + 4 * (1 - share)])
    assert row["max_abs_mm"] == pytest.approx(3) and row["kpa"] == data.pressures_kpa[3]
    shifted = Comparison(data, data.displacements + [0.3, -0.1], NONE).extremes_mm()
    for i, axis in enumerate("xz"):
        least, greatest = np.sort(data.displacements[-1, :, i])[[0, -1]]
        assert shifted["fem"][axis] == [least, greatest]
        assert shifted["surrogate"][axis] == pytest.approx([least + (0.3, -0.1)[i], greatest + (0.3, -0.1)[i]])


def test_dataset_without_training_points_are_unseen() -> None:
    data = small()
    nodes = len(data.domain.points_mm)
    rows = Comparison(data, data.displacements, np.arange(3 * nodes, 5 * nodes)).by_pressure()
    assert [i for i, row in enumerate(rows) if row["seen"]] == [3, 4]
    assert rows[3]["mse_x_mm2"] == 0  # trained on as a whole: judged on its training points


@pytest.mark.parametrize("split", ["random", "extrapolate"])
def test_assessment_writes_all_it_promises(split: str, tmp_path: Path) -> None:
    data = small()
    labels = replace(LABELS, split=split)
    seconds = {"simulate": 1.0, "simulate_cached": 0.0, "train": 2.0}
    selection = np.setdiff1d(np.arange(500), TRAIN)
    how = training(tmp_path, {"data": {}})
    found = assess(Shifted(), data, TRAIN, selection, plugin("split", split)(), labels, seconds, tmp_path, how)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics == json.loads(json.dumps(found.metrics))
    assert list(metrics) == [
        "finger", "fem", "split", "model", "losses", "left_out", "seed", "points", "train_points",
        "selection_points", "test_points", "seconds", "warnings", "surrogate_error", "discretisation_error", "mse_mm2",
        "selection_mm2", "error_bar", "by_pressure", "extremes_mm", "curvature", "latency_ms", "residuals", "yardstick",
    ]  # fmt: skip
    assert metrics["surrogate_error"]["rms_mm"] == pytest.approx(np.hypot(0.3, 0.1))
    assert metrics["surrogate_error"]["largest_mm"] == pytest.approx(np.hypot(0.3, 0.1))
    assert metrics["discretisation_error"] is None and metrics["warnings"] == []
    parts = [metrics[f"{part}_points"] for part in ("train", "selection", "test")]
    assert metrics["points"] == sum(parts) == 20 * len(data.domain.points_mm) and parts[1] == len(selection)
    assert metrics["selection_mm2"] == pytest.approx({"x": 0.09, "z": 0.01})
    assert set(metrics["seconds"]) == {"simulate", "simulate_cached", "train", "assess"}
    assert metrics["mse_mm2"] == pytest.approx({"x": 0.09, "z": 0.01})
    assert len(metrics["by_pressure"]) == len(metrics["curvature"]) == 20
    assert set(metrics["by_pressure"][0]) == {"kpa", "seen", "mse_x_mm2", "mse_z_mm2", "max_abs_mm", "covered"}
    assert metrics["curvature"][-1]["kpa"] == MAX_KPA
    assert metrics["curvature"][-1]["rms_distance_mm"] == pytest.approx(np.hypot(0.3, 0.1))
    extremes = metrics["extremes_mm"]
    assert extremes["surrogate"]["x"][0] - extremes["fem"]["x"][0] == pytest.approx(0.3)
    for part in (metrics["latency_ms"], metrics["latency_ms"]["all_threads"]):
        assert 0 < part["tip"]["median"] <= part["tip"]["p99"] and part["full_field"]["median"] > 0
    drawn = {"field_x", "field_z", "base_lines", "mse_over_pressure", "loss_history"}
    assert {path.stem for path in found.figures} == drawn == {path.stem for path in (tmp_path / "figures").iterdir()}
    assert all(path.stat().st_size > 10_000 for path in found.figures)
    console = Console(width=140, record=True, file=io.StringIO())
    console.print(closing_table(found.metrics, found.highlights, published("pneunet", split)))
    text = console.export_text()
    assert all(unit in text for unit in ("[kPa]", "[mm²]", "[mm]", "[s]", "[ms]"))
    assert "simulation, not known" in text
    assert "9.00e-02" in text and "-63.43" in text and ("0.017" in text) == (split == "extrapolate")


@pytest.mark.parametrize(("tip_mm", "shown"), [(0.0004, "0.0004"), (3.0, "3")])
def test_the_error_of_the_mesh_stands_beside_that_of_the_surrogate_whatever_its_size(
    tip_mm: float, shown: str, tmp_path: Path
) -> None:
    error = {"kpa": MAX_KPA, "tip_mm": tip_mm, "tip_percent": 1.25, "largest_mm": 7.5}
    data = replace(small(), provenance={"discretisation_error": error})
    split, how = plugin("split", "random")(), training(tmp_path, {"data": {}})
    found = assess(Shifted(), data, TRAIN, TRAIN[:0], split, LABELS, {}, tmp_path, how)
    assert json.loads((tmp_path / "metrics.json").read_text())["discretisation_error"] == error
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(closing_table(found.metrics, found.highlights, published("comb", "random")))
    (surrogate,) = re.findall(r"surrogate, at unseen points.*", text := console.export_text())
    (mesh,) = re.findall(r"simulation, at 50 kPa.*", text)
    assert re.findall(r"[\d.–]+", surrogate)[0] == "0.32"  # the root of 0.3² + 0.1²
    assert re.findall(r"[\d.–]+", mesh)[1:] == ["–", shown, "1.2", "7.5"]


def test_the_error_of_the_tip_is_that_of_its_length() -> None:
    data = small()
    predicted = data.displacements.copy()
    predicted[3, data.domain.base[-1]] += [3.0, 4.0]
    found = Comparison(data, predicted, np.arange(3)).error()
    moved = np.linalg.norm(data.displacements[:, data.domain.base[-1]], axis=1).max()
    assert (found["tip_mm"], found["largest_mm"], found["tip_percent"]) == pytest.approx((5.0, 5.0, 500 / moved))
    still = replace(data, fields={DISPLACEMENT: np.zeros_like(data.displacements)})
    assert Comparison(still, predicted, np.arange(3)).error()["tip_percent"] is None


def test_coverage_is_the_share_of_unseen_errors_within_the_bars() -> None:
    data = small()
    train = np.arange(0, data.displacements.size // 2, 7)
    bars = np.full(data.displacements.shape[:2], 0.2)  # of errors (0.3, −0.1)
    bars[4:] = 0.4
    bars.flat[train] = 99.0  # must not show
    comparison = Comparison(data, data.displacements + [0.3, -0.1], train, bars)
    found = comparison.error_bar()
    assert found is not None and found["covered_z"] == 1 and found["median_mm"] == 0.4
    assert found["covered_x"] == pytest.approx(0.8, abs=0.01)
    assert [row["covered"] for row in comparison.by_pressure()] == [0.5] * 4 + [1.0] * 16


def test_table_shows_the_yardstick_and_the_coverage_beside_the_model(tmp_path: Path) -> None:
    data, split = small(), plugin("split", "random")()
    chosen = training(tmp_path, {"data": {"weight": 0.0}, "navier_cauchy": {}, "section": {}})
    yardstick = measure(plugin("model", "finite_element")(), chosen, data, TRAIN, NONE)
    assert yardstick["model"] == "finite_element" and yardstick["mse_mm2"]["x"] < 1e-2
    found = assess(
        Shifted(), data, TRAIN, NONE, split, LABELS, {}, tmp_path, training(tmp_path, {"data": {}}), yardstick
    )
    barred = {**found.metrics, "error_bar": {"covered_x": 0.9, "covered_z": 1.0, "median_mm": 1.0}}
    barred["by_pressure"] = [{**row, "covered": 0.777} for row in found.metrics["by_pressure"]]
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(closing_table(barred, found.highlights, published("pneunet", "random")))
    text = console.export_text()
    assert "yardstick finite_element" in text and f"{yardstick['mse_mm2']['z']:.2e}" in text
    assert "77.7%" in text and "95.0%" in text


def test_the_paper_stands_beside_its_own_fingers_alone(tmp_path: Path) -> None:
    data, split, finger = small(), plugin("split", "random"), plugin("finger", "pneunet")
    assert comparable(finger(), split()) == published("pneunet", "random")
    others = (finger(chambers=3), finger(max_kpa=20.0), finger(material=Yeoh(c1_mpa=0.2)), plugin("finger", "mesh")())
    assert all(comparable(other, split()) == Published() for other in others)
    fewer = comparable(finger(), split(points=300))
    assert fewer.fem_mm and not fewer.mse_mm2 and not fewer.surrogate_mm
    assert not comparable(finger(), plugin("split", "extrapolate")(train_fraction=0.5, tested=[0.9])).mse_mm2

    found = assess(Shifted(), data, TRAIN, NONE, split(), LABELS, {}, tmp_path, training(tmp_path, {"data": {}}))
    for paper, words in ((Published(), 0), (fewer, 1), (published("pneunet", "random"), 4)):
        console = Console(width=140, record=True, file=io.StringIO())
        console.print(closing_table(found.metrics, found.highlights, paper))
        text = console.export_text()
        assert text.count("paper") == words and ("-63.43" in text) == bool(words)


def test_history_and_table_name_the_unit_of_each_loss(tmp_path: Path) -> None:
    losses = {name: plugin("loss", name)() for name in names("loss")}
    history = [{f"{key}/{name}": 1.0 for name in losses for key in ("raw", "weighted", "share")} | {"seconds": 1.0}]
    build = figures._loss_history(history, {name: loss.unit for name, loss in losses.items()})
    labels = [text.get_text() for text in build().axes[0].get_legend().get_texts()]
    assert {"traction [MPa²]", "equilibrium [–]", "data [mm²]", "yeoh [(N/mm³)²]"} <= set(labels)
    assert len(labels) == len(losses) and all("[" in label for label in labels)

    how = training(tmp_path, {"data": {}, "boundary": {}})
    found = assess(Shifted(), small(), TRAIN, NONE, plugin("split", "random")(), LABELS, {}, tmp_path, how)
    console = Console(width=140, record=True, file=io.StringIO())
    console.print(closing_table(found.metrics, found.highlights, Published()))
    assert "boundary [mm²]" in console.export_text()


def test_published_figures_belong_to_known_splits() -> None:
    assert all(split in ("random", "extrapolate") for _, split in PUBLISHED)
    assert published("mine", "random").mse_mm2 == {}
