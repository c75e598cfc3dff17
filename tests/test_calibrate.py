"""The calibration script: what it minimises, and that a stopped search goes on where it was."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.conftest import CHECKOUT
from tests.fingers import solid


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("calibrate", CHECKOUT / "examples" / "calibrate.py")
    assert spec is not None and spec.loader is not None
    module = sys.modules["calibrate"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["pneunet", "joints", "bellows"])
def test_the_ranges_hold_possible_fingers(script: ModuleType, name: str) -> None:
    calibration = script.Calibration(name)
    for end in (0, 1):
        calibration.made({dimension: ends[end] for dimension, ends in calibration.search.open.items()}).mesh(6.0)


def test_misfit_counts_tolerances(script: ModuleType) -> None:
    calibration = script.Calibration("pneunet")
    off = np.array([[0.02 * 63.426, 0.02 * 11.234], [-0.02 * 105.24, 0.5]])
    assert calibration.misfit(calibration.target, calibration.target) == 0
    assert calibration.misfit(calibration.target + 3 * off, calibration.target) == pytest.approx(3)


def test_extremes_that_the_paper_leaves_out_do_not_count(script: ModuleType) -> None:
    calibration = script.Calibration("joints")
    found = np.array([[-1e3, 1e3], [-69.94, 0.21]])
    assert calibration.misfit(found, calibration.target) == 0


def test_a_search_goes_on_where_it_stopped(script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = script.Search(open={"base_mm": (2.0, 6.0)}, fixed={"chambers": 2, "max_kpa": 20.0})
    monkeypatch.setitem(script.SEARCHES, "pneunet", small)
    monkeypatch.setattr(script, "FOLDER", tmp_path / "calibration")
    monkeypatch.setattr(script.paths, "RUNS", tmp_path)

    def calibration() -> Any:
        made = script.Calibration("pneunet")
        made.coarse, made.fine = solid(), solid(element="hex27_p1")
        made.target = np.array([[-8.0, 1.5], [-22.0, 0.0]])
        made.tolerance[:] = 1.0
        return made

    first = calibration().run(trials=3, rounds=2)
    again = calibration()
    monkeypatch.setattr(script.Calibration, "__call__", None)  # every trial is there already
    assert again.run(trials=3, rounds=2) == first
