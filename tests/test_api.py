"""What a Python user gets from `import pgdl_lab`."""

import doctest
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pgdl_lab as lab
from pgdl_lab import api
from pgdl_lab.running import composing
from pgdl_lab.running.experiment import Experiment
from tests import stub
from tests.trainings import small


@pytest.fixture
def data(root: Path) -> lab.Dataset:
    finger = lab.Pneunet(chambers=2, max_kpa=10.0)
    return lab.simulate(finger, "rod", observation=lab.Observation(snapshots=10, points=200))


def test_import_brings_nothing_heavy_and_no_names_of_others() -> None:
    heavy = "('numpy', 'torch', 'hydra', 'omegaconf', 'mlflow')"
    code = f"import sys, pgdl_lab; print([module for module in {heavy} if module in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout == "[]\n"
    names = [name for name in dir(lab) if not name.startswith("_")]
    assert {"simulate", "train", "load", "Pneunet", "Pod", "Solid", "Ogden", "BoundaryLoss"} <= {*names}
    assert not {"Path", "Any", "annotations", "import_module", "version", "TYPE_CHECKING"} & {*names}
    for name in names:
        assert getattr(lab, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'Pneumatic'"):
        _ = lab.Pneumatic  # type: ignore[attr-defined]


def test_examples_in_docstrings(root: Path) -> None:
    found = doctest.testmod(api)
    assert found.attempted >= 8
    assert found.failed == 0


def test_type_checkers_see_what_there_is() -> None:
    assert stub.PATH.read_text(encoding="utf-8") == stub.text(), "run python -m tests.stub"


def test_what_is_not_chosen_is_as_on_the_command_line() -> None:
    assert Experiment.of() == replace(composing.experiment([]), yardstick=None)
    typed = composing.experiment(["model=mlp", "split=extrapolate", "loss=[data,boundary]", "seed=3", "finger=bellows"])
    chosen = Experiment.of(
        model="mlp", split="extrapolate", loss=["data", lab.BoundaryLoss()], seed=3, finger="bellows"
    )
    assert chosen == replace(typed, yardstick=None)


def test_a_training_gives_what_the_command_line_gives(data: lab.Dataset, tmp_path: Path) -> None:
    how = composing.experiment(["model=pod", "split.points=500", "seed=2"])
    train = how.split.train_points(data, 2)
    finger = lab.Pneunet(chambers=2, max_kpa=10.0)
    fitted = how.model.fit(replace(how, finger=finger).training(data, train, tmp_path))
    surrogate = lab.train(data, lab.Pod(), split=lab.RandomSplit(points=500), seed=2, folder=tmp_path / "run")
    at = data.domain.points_mm[::7]
    np.testing.assert_array_equal(surrogate.predict(at, 7.0), fitted.predict(at, 7.0))

    unseen = np.ones(data.displacements.shape[:2], dtype=bool)
    unseen.flat[train] = False
    off = np.linalg.norm(fitted.predict(data.domain.points_mm, data.pressures_kpa) - data.displacements, axis=2)[unseen]
    assert surrogate.error["rms_mm"] == pytest.approx(np.sqrt((off**2).mean()), rel=1e-12)
    assert lab.load(tmp_path / "run" / "surrogate.pt").error == surrogate.error


def test_refusals_name_the_remedy(data: lab.Dataset) -> None:
    with pytest.raises(lab.InputError, match="no finger 'pneunt'. Did you mean 'pneunet'"):
        lab.simulate("pneunt")
    with pytest.raises(lab.InputError, match="ask for fewer or raise observation.points"):
        lab.train(data)
    with pytest.raises(lab.InputError, match="make it with pgdl_lab.simulate"):
        lab.train(replace(data, provenance={}))
    with pytest.raises(lab.InputError, match="pressure_kpa is 11; this dataset goes from 1 to 10 kPa"):
        data.plot(11.0)


def test_a_plugin_of_a_notebook_trains(data: lab.Dataset) -> None:
    @lab.register("split", "left_half")
    @dataclass(frozen=True)
    class LeftHalf(lab.RandomSplit):
        def seen(self, cases: Any) -> Any:
            return cases.pressures_kpa < 6

    surrogate = lab.train(data, "pod", split=LeftHalf(points=300))
    assert surrogate.ranges["pressure_kpa"] == [1.0, 5.0]


def test_pictures_show_the_bent_face(data: lab.Dataset) -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    data.plot(6.2, axes)
    assert axes.get_title() == "pneunet at 6 kPa"
    line = axes.lines[-1]
    bent = (data.domain.points_mm + data.displacements[5])[data.domain.base]
    np.testing.assert_array_equal(np.column_stack([line.get_xdata(), line.get_ydata()]), bent)
    page = data._repr_html_()
    assert "200 points of its side face at 10 pressures" in page
    assert "data:image/png;base64,iVBOR" in page
    assert "The finger is short for fem=rod" in page  # a simulation's doubts go with its picture


def test_the_made_up_finger_says_what_it_is() -> None:
    assert repr(small()).startswith("<Dataset of a finger by unknown elements")
