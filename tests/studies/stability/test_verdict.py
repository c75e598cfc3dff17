"""How honest a trial was: hand-made cases whose score is plain."""

import ast
import math
import re
from pathlib import Path

import numpy as np
import pytest

from pgdl_lab.core import paths
from pgdl_lab.studies.stability.claims import REMARK, UNKNOWN, claim
from pgdl_lab.studies.stability.learning import bar_of
from pgdl_lab.studies.stability.outcome import (
    ACCURACY,
    CAUSES,
    CONTACT,
    DATA,
    RANGE,
    TRAINING,
    UNSTABLE,
    Bar,
    Trial,
    wilson,
)
from pgdl_lab.studies.stability.verdict import ALARM, BAR, CRASH, NONE, OUTCOMES, RIGHT, SAID, SILENT, counts, judge

MESH = (
    "On a mesh with half the edges the tip would lie 0.29 mm elsewhere at 20 kPa, {} % of its displacement: lower it."
)
CAUTION = "fem=rod leaves out that walls stiffen, and does not know its own error. Compare with fem=solid."
SIDEWAYS = "At 3 kPa and 2 other pressures of 9 the finger gives way sideways, which half a finger cannot show."
CROSSING = "Surfaces pass through each other at 3 kPa and more: use fem.contact=auto."
FAR = "25 kPa lies outside the trained 1 to 20 kPa: give pressures within them, with an error bar of up to 8.9e-05 mm."
HOLES = "No training point lies within 3 mm of x = 13.5, z = 17 mm: what the model says there is a guess."
NOISY = "The model's own error bars are 8.2 % of the displacement: its data are too few or too noisy for it."
HELD = Bar("95 %", holds=True, coverage=0.96, ratio=0.9, worst=1.4)
BROKEN = Bar("95 %", holds=False, coverage=0.02, ratio=900.0, worst=4000.0)


def trial(
    error: float,
    *told: str,
    causes: tuple[str, ...] = (),
    bars: tuple[Bar, ...] = (),
    mode: str = "",
    partly: tuple[str, ...] = (),
) -> Trial:
    mode = mode or ("ok" if error <= 0.05 else "wrong")
    return Trial("mechanics", "gravity", "1", "rod", 0, mode, error, causes, bars, partly, told, 1.0)


def mesh(ratio: float) -> Bar:
    return Bar("mesh", holds=ratio <= 2, coverage=1.0, ratio=ratio, worst=ratio)


@pytest.mark.parametrize(
    ("what", "outcome"),
    [
        (trial(0.01), RIGHT),
        (trial(0.2), SILENT),
        (trial(0.2, CAUTION), SAID),
        (trial(0.01, CAUTION), ALARM),
        # a warning counts only if it says what is wrong
        (trial(0.9, CAUTION, causes=(UNSTABLE,)), SILENT),
        (trial(0.9, CAUTION, SIDEWAYS, causes=(UNSTABLE,)), SAID),
        (trial(0.9, SIDEWAYS, causes=(UNSTABLE, CONTACT)), SILENT),
        (trial(0.9, SIDEWAYS, CROSSING, causes=(UNSTABLE, CONTACT)), SAID),
        (trial(0.3, HOLES, causes=(RANGE,)), SILENT),
        (trial(0.3, FAR, causes=(RANGE,)), SAID),
        (trial(0.3, FAR, causes=(TRAINING, RANGE)), SILENT),
        # a right displacement of a body that passes through itself, or that gives way, is not right
        (trial(0.01, causes=(CONTACT,)), SILENT),
        (trial(0.01, SIDEWAYS), ALARM),
        (trial(0.01, CROSSING), ALARM),
        # a number counts by whether it holds, whatever was printed
        (trial(0.38, FAR, causes=(RANGE,), bars=(BROKEN,)), BAR),
        (trial(0.01, bars=(BROKEN,)), BAR),
        (trial(0.2, causes=(DATA,), bars=(HELD,)), SAID),
        (trial(0.01, bars=(HELD,)), RIGHT),
        (trial(0.04, MESH.format(3.9), bars=(mesh(0.9),)), RIGHT),
        (trial(0.01, MESH.format(3.9), bars=(mesh(0.2),)), ALARM),
        (trial(0.08, MESH.format(3.9), bars=(mesh(2.5),)), BAR),
        (trial(0.08, bars=(mesh(1.5),)), SAID),
        (trial(0.9, bars=(mesh(0.9),), causes=(UNSTABLE,)), SILENT),
        (trial(0.01, HOLES), ALARM),
        (trial(0.01, HOLES, partly=(DATA,)), RIGHT),
        (trial(0.03, NOISY, bars=(HELD,)), RIGHT),
        (trial(0.001, NOISY, bars=(Bar("95 %", holds=True, coverage=1.0, ratio=0.1, worst=0.3),)), ALARM),
        (trial(0.2, "Something that nobody knows."), SILENT),
        (trial(math.nan, mode="not a number"), SILENT),
        (trial(math.nan, "It stopped at 3 kPa.", mode="stopped"), NONE),
        (trial(math.nan, "Too thin.", mode="refused"), NONE),
        (trial(math.nan, "ZeroDivisionError: oh", mode="crashed"), CRASH),
    ],
)  # fmt: skip
def test_a_trial_is_scored_by_what_was_said_of_what_is_wrong(what: Trial, outcome: str) -> None:
    assert judge(what).outcome == outcome


def test_false_alarms_and_what_was_not_named_are_told() -> None:
    verdict = judge(trial(0.9, CROSSING, FAR, causes=(UNSTABLE,)))
    assert verdict.unnamed == (UNSTABLE,) and verdict.false == (CONTACT, RANGE)


def test_no_trial_is_dropped() -> None:
    trials = [trial(0.01), trial(0.2), trial(0.01, CAUTION, bars=(BROKEN,)), trial(math.nan, "Oh.", mode="crashed")]
    row = counts(trials)
    assert sum(row[outcome] for outcome in OUTCOMES) == row["trials"] == 4
    assert (row[RIGHT], row[SILENT], row[BAR], row[CRASH]) == (1, 1, 1, 1)
    assert row["with a false alarm"] == 1 and row["bars that hold"] == 0 and row["worst ratio"] == 4000


def test_bars_are_scored_by_how_many_errors_they_cover() -> None:
    errors = np.tile([[0.5, 0.9]], (50, 1))
    errors[0, 0] = 5.0
    held = bar_of(errors, np.ones(50))
    assert held.holds and held.coverage == 0.99 and held.ratio == pytest.approx(0.9) and held.worst == 5
    broken = bar_of(errors, np.full(50, 0.6))
    assert not broken.holds and broken.coverage == 0.49 and broken.ratio == pytest.approx(1.5)


def test_wilson_interval() -> None:
    low, high = wilson(8, 10)  # as in Brown, Cai and DasGupta, Statistical Science 16, 2001: closed form
    assert low == pytest.approx(0.4902, abs=1e-4) and high == pytest.approx(0.9433, abs=1e-4)
    assert wilson(0, 10)[0] == 0 and wilson(10, 10)[1] == 1
    assert wilson(0, 0) == (0.0, 1.0)


def test_a_warning_that_states_a_size_is_told_from_one_that_does_not() -> None:
    assert [claim(each).stated for each in (MESH, FAR, NOISY)] == 3 * [True]
    assert not claim(CAUTION).stated and claim("Hello.").cause == UNKNOWN


WARNED = ("pgdl_lab/mechanics", "pgdl_lab/learning", "plugins/fem", "plugins/model", "plugins/loss")


def warnings_of(path: Path) -> list[str]:
    """All warnings that a module logs, with a number in each blank."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)]
    place = {"_log.warning": 0, "_log.log": 1}  # of the text among what is given
    first = [call.args[place[name]] for call in calls if (name := ast.unparse(call.func)) in place]
    texts = [each.value for each in first if isinstance(each, ast.Constant) and isinstance(each.value, str)]
    return [re.sub(r"%(\.\d+)?[gdsf]", "1", text).replace("%%", "%") for text in texts]


def test_every_warning_of_a_result_has_a_rule() -> None:
    """A new warning would count as silence: whoever adds one says here what it claims."""
    root = paths.CONF.parent
    found = [text for folder in WARNED for path in sorted((root / folder).glob("*.py")) for text in warnings_of(path)]
    assert len(found) >= 12
    assert [text for text in found if claim(text).cause == UNKNOWN and not re.fullmatch("1( Compare.*)?", text)] == []
    cautions = [(root / f"plugins/fem/{name}.py").read_text() for name in ("rod", "section")]
    assert all(claim(" ".join(text.split())).cause == ACCURACY for text in cautions)
    assert {claim(text).cause for text in found} <= {*CAUSES, REMARK, UNKNOWN}
