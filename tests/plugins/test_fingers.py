"""The extruded fingers `joints` and `bellows`: geometry, refusals, and a coarse simulation each."""

from typing import Any

import numpy as np
import pytest

from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.profile import Region
from tests.fingers import OBSERVATION, solid


def finger(name: str, **fields: Any) -> ExtrudedFinger:
    made = registry.plugin("finger", name)(**fields)
    assert isinstance(made, ExtrudedFinger)
    return made


def area(made: ExtrudedFinger, region: Region) -> float:
    profile = made.profile()
    return float((np.outer(np.diff(profile.x), np.diff(profile.z)) * (profile.regions == region)).sum())


def test_joints_have_chambers_only_in_the_joints() -> None:
    made = finger("joints")
    length = 10 + 3 * (3 * 4 + 2 * (2 + 1 + 2)) + 2 * 15.6 + 2 * 2 + 13.5
    assert made.profile().x[-1] == pytest.approx(length)
    channel = length - 10 - 13.5 - 2 * 2
    assert area(made, Region.CAVITY) == pytest.approx(9 * 4 * (2 + 7.5) + 2 * channel)
    assert area(made, Region.GAP) == pytest.approx(3 * 2 * 1 * (7.5 + 2))


def test_bellows_have_one_chamber_under_folds() -> None:
    made = finger("bellows")
    length = 5 + 15 * 4 + 14 * (1.75 + 2 + 1.75) + 2 * 1.75 + 5
    assert made.profile().x[-1] == pytest.approx(length)
    duct = length - 10 - 2 * 1.75
    assert area(made, Region.CAVITY) == pytest.approx(2 * duct + 15 * 4 * 3.7)
    assert area(made, Region.GAP) == pytest.approx(14 * 2 * 3.7)


@pytest.mark.parametrize(
    ("name", "fields", "sentence"),
    [
        ("joints", {"joints": 0}, "finger.joints is 0"),
        ("joints", {"wall_mm": 0.0}, "finger.wall_mm is 0.0 mm; it must be above 0"),
        ("joints", {"tip_mm": -1.0}, "finger.tip_mm is -1.0 mm; it must not be negative"),
        ("bellows", {"folds": 0}, "finger.folds is 0"),
        ("bellows", {"fold_mm": 1.0}, "it must exceed finger.wall_mm"),
    ],
)
def test_impossible_fingers_are_refused(name: str, fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        finger(name, **fields)


@pytest.mark.parametrize(
    ("name", "fields"),
    [("joints", {"joints": 1, "chambers": 2, "max_kpa": 20.0}), ("bellows", {"folds": 2, "max_kpa": 20.0})],
)
def test_they_bend_down(name: str, fields: dict[str, Any]) -> None:
    snapshots = solid().simulate(finger(name, **fields), OBSERVATION)
    tip = snapshots.displacements[:, snapshots.domain.base[-1], 1]
    assert (np.diff(tip) < 0).all()
