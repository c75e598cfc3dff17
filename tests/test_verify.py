"""Task `verify`: the quick benchmarks pass; a check that fails is told."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from numpy import float64
from omegaconf import OmegaConf

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.mechanics.elements import BEST
from pgdl_lab.studies.verification.benchmark import Benchmark, Check
from pgdl_lab.tasks import Job, verify
from tests.conftest import Lab


def job(folder: Path, quick: Any) -> Job:
    experiment: Any = None  # the benchmarks have their own scenes
    return Job(experiment, OmegaConf.create({"quick": quick}), folder, None)


def test_quick_benchmarks_pass_and_are_written_down(lab: Lab, tmp_path: Path) -> None:
    done = lab("task=verify", "quick=true")
    assert done.returncode == 0, done.stdout + done.stderr
    (file,) = tmp_path.glob("runs/*/verify.json")
    rows = json.loads(file.read_text())
    assert len({row["benchmark"] for row in rows}) >= 9
    assert all(row["passed"] for row in rows)
    assert [row["check"] for row in rows if row["reference"] == row["obtained"] == 0] == []  # shows nothing
    orders = [row["check"] for row in rows if row["benchmark"] == "manufactured Yeoh solution"]
    assert {check.split(",")[0] for check in orders} == set(BEST.values())  # the elements that a run takes by itself
    assert sum(row["seconds"] for row in rows) < 120  # some 30 s on two quiet cores
    with file.with_suffix(".csv").open(newline="") as table:
        assert [row["check"] for row in csv.DictReader(table)] == [row["check"] for row in rows]


def test_failures_are_told_and_do_not_hide_other_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def checks(quick: bool) -> Iterator[Check]:
        yield Check("good [mm]", 1.0, 1.05, float64(0.1), "made up")
        yield Check("bad [mm]", 1.0, float("nan"), 0.1, "made up")
        raise RuntimeError("broken")

    def more(quick: bool) -> Iterator[Check]:
        yield Check("slow [mm]", 1.0, 1.0, 0.0, "made up")

    monkeypatch.setattr(verify, "BENCHMARKS", [Benchmark("first", checks, True), Benchmark("second", more, False)])
    with pytest.raises(LabError, match=r"2 of 4 checks failed \(first, bad \[mm\]; first, RuntimeError: broken\)"):
        verify.run(job(tmp_path, quick=False))
    rows = json.loads((tmp_path / "verify.json").read_text())
    assert [row["passed"] for row in rows] == [True, False, False, True]
    page = (tmp_path / "verify.md").read_text(encoding="utf-8")
    assert "2 of 4 checks passed" in page and page.count("**NO**") == 2
    assert "| good [mm] | 1 | 1.05 | 0.1 | yes | made up |" in page and "| RuntimeError: broken | – |" in page
    with pytest.raises(LabError, match="2 of 3"):
        verify.run(job(tmp_path, quick=True))


@pytest.mark.parametrize(
    ("name", "reference", "tolerance", "sentence"),
    [
        ("force [N]", 0.0, 1e-8, "'force .N.' is compared with 0: make it relative"),
        ("force over weight [–]", 0.0, 1.0, "has the tolerance 1, with which 0 would pass"),
        ("force [N]", -2.0, 2.0, "has the tolerance 2, with which 0 would pass"),
    ],
)
def test_checks_that_nothing_at_all_would_pass_are_refused(
    name: str, reference: float, tolerance: float, sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        Check(name, reference, 0.0, tolerance, "made up")


def test_quick_is_yes_or_no(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="quick is 'perhaps'"):
        verify.run(job(tmp_path, quick="perhaps"))
