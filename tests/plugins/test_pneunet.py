from typing import Any

import pytest

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.finger import ExtrudedFinger
from tests.fingers import pneunet


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"chambers": 0}, "finger.chambers is 0"),
        ({"gap_mm": -1.0}, "finger.gap_mm is -1.0 mm; it must be above 0"),
        ({"base_mm": 0.0}, "finger.base_mm is 0.0 mm"),
        ({"channel_mm": float("nan")}, "finger.channel_mm is nan mm"),
        ({"tip_mm": -2.0}, "finger.tip_mm is -2.0 mm; it must not be negative"),
        ({"wall_mm": 5.25}, "two walls must be thinner than the chamber"),
        ({"height_mm": 8.0}, "it must exceed channel, bridge and roof together"),
        ({"side_wall_mm": 8.0}, "finger.side_wall_mm is 8.0 mm; it must be above 0 and below half of finger.width_mm"),
        ({"max_kpa": 0.0}, "finger.max_kpa is 0.0 kPa"),
        ({"density_kg_m3": -1.0}, "finger.density_kg_m3 is -1.0"),
        ({"gravity_m_s2": [9.81]}, "give its x and z components"),
        ({"gravity_m_s2": [0.0, float("nan"), 0.0]}, "give its x and z components"),
    ],
)
def test_impossible_fingers_are_refused(fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        pneunet(**fields)


def test_table_one_of_the_paper() -> None:
    finger = pneunet(chambers=10)
    assert isinstance(finger, ExtrudedFinger)
    profile = finger.profile()
    assert profile.x[-1] == pytest.approx(10 * 10.5 + 9 * 1)
    assert profile.z[-1] - profile.z[1] == pytest.approx(14)


def test_root_and_tip_are_solid_blocks() -> None:
    plain, longer = pneunet(), pneunet(root_mm=4.0, tip_mm=6.0)
    assert longer.mesh(3.0).p[0].max() == pytest.approx(plain.mesh(3.0).p[0].max() + 10)
    assert longer.face(1000).domain.points_mm[:, 0].max() == pytest.approx(22 + 10)
