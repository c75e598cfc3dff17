"""What `sweep=calibrate` makes of a finger."""

import json
from pathlib import Path

import pytest

from pgdl_lab.cli import store_choices
from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.search import objectives
from pgdl_lab.search.calibration import dimensions, targets
from pgdl_lab.search.space import parse


@pytest.mark.parametrize("name", ["pneunet", "joints", "bellows"])
def test_open_dimensions_make_possible_fingers_and_hold_what_was_found(name: str) -> None:
    store_choices()
    searched = {each.name: each.distribution for each in parse(dimensions(name), []).parameters}
    finger = registry.plugin("finger", name)
    for end in ("low", "high"):
        finger(**{key.removeprefix("finger."): getattr(each, end) for key, each in searched.items()}).mesh(12.0)
    for key, each in searched.items():
        assert each.low < getattr(finger(), key.removeprefix("finger.")) < each.high


def test_the_worst_misfit_counts_in_tolerances(tmp_path: Path) -> None:
    assert targets("pneunet")["extremes_mm.fem.z.1"] == [0.25, 0.5]
    found = {"x": [-63.426, 11.234 * 1.03], "z": [-105.24 * 1.01, 1.25]}
    (tmp_path / "metrics.json").write_text(json.dumps({"extremes_mm": {"fem": found}}))
    assert objectives.values(tmp_path, ["misfit"], targets("pneunet")) == [pytest.approx(2.0)]
    only_z = {"extremes_mm.fem.z.0": [-105.24, 2.1048]}
    assert objectives.values(tmp_path, ["misfit"], only_z) == [pytest.approx(0.5)]


def test_a_finger_without_open_dimensions_or_extremes_is_refused() -> None:
    store_choices()
    with pytest.raises(InputError, match="finger=mesh has no open dimensions"):
        dimensions("mesh")
    with pytest.raises(InputError, match="The paper has no extremes of finger=mesh"):
        targets("mesh")
