"""Every form gives the numbers of the original, and the task puts them beside it."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import pgdl_lab
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.export import export as exporting
from pgdl_lab.export.export import Form, export
from tests.conftest import Lab
from tests.test_surrogate import trained
from tests.trainings import small


@pytest.mark.parametrize("name", ["pod", "mlp", "body"])
def test_every_form_answers_any_number_of_points_and_pressures(name: str, tmp_path: Path) -> None:
    surrogate = trained(name, tmp_path)
    forms = list(export(surrogate, tmp_path / "export"))
    made = [form for form in forms if isinstance(form, Form)]
    assert [form.name for form in made] == ["numpy", "torch.export", "onnx"][name == "body" :]
    points = small().domain.points_mm[::7]
    truth = surrogate.predict(points, [1.0, 20.0, 50.0])
    for form in made:
        assert np.abs(form.predict(points, np.array([1.0, 20.0, 50.0])) - truth).max() <= form.tolerance_mm
        assert form.predict(points[:1], np.array([20.0])).shape == (1, 1, 2)
        if name == "pod":
            assert form.difference_mm <= (0 if form.name == "numpy" else 1e-12)
    if name == "body":
        assert "has no plain NumPy form" in str(forms[0])
    else:
        again = pgdl_lab.load(tmp_path / "export" / "surrogate.npz")
        assert again.model == surrogate.model and again.ranges == surrogate.ranges
        assert again.tip_mm == pytest.approx(surrogate.tip_mm)


def test_a_graph_says_what_lies_off_the_body(tmp_path: Path) -> None:
    *_, onnx = (form for form in export(trained("pod", tmp_path), tmp_path / "export") if isinstance(form, Form))
    answer = onnx.predict(np.array([[11.0, 15.0], [500.0, 0.0], [5.0, 5.0]]), np.array([10.0]))
    assert np.isnan(answer[0, :2]).all() and np.isfinite(answer[0, 2]).all()


def test_a_form_that_differs_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporting, "largest_difference_mm", lambda *_: float("nan"))
    with pytest.raises(LabError, match=r"surrogate\.npz differs from the original by nan mm"):
        list(export(trained("pod", tmp_path), tmp_path / "export"))


def test_other_files_are_no_plain_surrogates(tmp_path: Path) -> None:
    path = tmp_path / "surrogate.npz"
    np.savez(path, about=np.array([object()], dtype=object))
    with pytest.raises(InputError, match=r"damaged or not a surrogate of pgdl_lab \('about' holds objects"):
        pgdl_lab.load(path)
    np.savez(path, about=np.array(json.dumps({"format": "another"})))
    with pytest.raises(InputError, match="is not a surrogate of pgdl_lab"):
        pgdl_lab.load(path)
    with pytest.raises(InputError, match="No such file"):
        pgdl_lab.load(tmp_path / "none.npz")


def test_task_writes_beside_the_surrogate(lab: Lab, small_run: Path, tmp_path: Path) -> None:
    before = (small_run / "config.yaml").read_text()
    done = lab("task=export")
    assert done.returncode == 0, done.stderr
    rows = json.loads((small_run / "export" / "export.json").read_text())
    assert [row["form"] for row in rows] == ["numpy", "torch.export", "onnx"]
    assert all((small_run / "export" / row["file"]).stat().st_size == row["bytes"] for row in rows)
    assert (small_run / "config.yaml").read_text() == before
    assert os.path.realpath(tmp_path / "runs" / "latest") == str(small_run)
    assert "works on one run: leave out -m" in lab("-m", "task=export", "seed=1,2").stderr
    shutil.move(small_run / "surrogate.pt", tmp_path)
    assert "holds no surrogate.pt: give the folder of a training" in lab("task=export").stderr
    assert "There is no run in 'gone'" in lab("task=export", "run=gone").stderr
