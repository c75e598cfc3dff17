"""Searches select by points that are neither trained on nor tested on."""

import json
from pathlib import Path

import numpy as np
import optuna
import pytest

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.data import Samples
from pgdl_lab.running.trial import Ticket
from pgdl_lab.search import objectives
from pgdl_lab.search.pruning import Pruning
from pgdl_lab.search.report import mesh_error
from pgdl_lab.search.settings import SearchSettings
from pgdl_lab.search.storage import open_storage
from tests.trainings import TRAIN, small, training

discover()


def pruning(folder: Path, selection: Samples) -> tuple[Pruning, optuna.Study]:
    """What watches a trial of a new study in `folder` as by default, and the study."""
    study = optuna.create_study(study_name="s", storage=open_storage(None, folder))
    pruner, report = {"_target_": "optuna.pruners.NopPruner"}, SearchSettings("s").report
    ticket = Ticket("s", None, 0, study.ask()._trial_id, pruner, report, None)
    return Pruning(ticket, folder / "0", selection), study


def test_the_pruner_sees_the_error_at_the_points_to_select_by(tmp_path: Path) -> None:
    data = small()
    selection = Samples.of(data, np.setdiff1d(np.arange(data.displacements.size // 2), TRAIN)[::40])
    watching, study = pruning(tmp_path, selection)
    how = training(tmp_path, {"data": {}}, callbacks=[watching], validation=0.0, max_epochs=4)
    surrogate = plugin("model", "mlp")(depth=1, width=8, dtype="float64").fit(how)
    seen = study.trials[0].intermediate_values
    predicted = [
        surrogate.predict(point[None], kpa)[0]
        for point, kpa in zip(selection.points_mm, selection.pressures_kpa, strict=True)
    ]
    assert list(seen) == [1, 2, 3, 4]
    assert seen[4] == pytest.approx(((np.array(predicted) - selection.displacements_mm) ** 2).sum(axis=1).mean())
    assert seen[1] > seen[4]


def test_no_points_to_select_by_are_told(tmp_path: Path) -> None:
    nothing = Samples.of(small(), np.empty(0, dtype=np.int64))
    with pytest.raises(InputError, match=r"no points to select by: split\.points takes nearly all"):
        pruning(tmp_path, nothing)
    (tmp_path / "metrics.json").write_text(json.dumps({"mse_mm2": {"x": 1.0, "z": 2.0}, "selection_mm2": None}))
    settings = SearchSettings("s")
    with pytest.raises(InputError, match="no points to select by"):
        objectives.values(tmp_path, settings.directions, {})
    assert objectives.values(tmp_path, ["mse_mm2.x+mse_mm2.z"], {}) == [3.0]  # as studies of earlier versions ask


def test_the_error_of_the_mesh_is_told_beside_what_no_trial_counts(tmp_path: Path) -> None:
    assert "is not known" in mesh_error(tmp_path)
    (tmp_path / "metrics.json").write_text('{"discretisation_error": {"kpa": 40.0, "tip_mm": 0.0434}}')
    assert "the tip 0.043 mm elsewhere at 40 kPa on half the edges" in mesh_error(tmp_path)
    (tmp_path / "metrics.json").write_text('{"discretisation_error": null}')
    assert "is not known" in mesh_error(tmp_path)
