"""Whether a method was honest: it names what is wrong and nothing else, and the numbers that it states hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pgdl_lab.studies.stability.claims import claim
from pgdl_lab.studies.stability.outcome import ACCURACY, CAUSES, MODES, WIDE, Trial, wilson

RIGHT, ALARM, SAID, BAR, SILENT, NONE, CRASH = OUTCOMES = (
    *("right", "right, false alarm", "wrong, says so", "wrong bar", "silently wrong", "no result", "crashed"),
)
MEANING = {
    RIGHT: "right",
    ALARM: "right, but warned of an error that is not there",
    SAID: "wrong, and said what is wrong",
    BAR: "stated an error bar that does not hold",
    SILENT: "wrong, and did not say what is wrong",
    NONE: "gave no result, but a sentence why",
    CRASH: "crashed",
}


@dataclass(frozen=True)
class Verdict:
    """How honest a trial was.

    Attributes
    ----------
    outcome
        One of `OUTCOMES`; a bar that does not hold outweighs all that was said.
    unnamed
        What is truly wrong and was not named, of `CAUSES`.
    false
        What was warned of and is not there, of `CAUSES`.
    """

    outcome: str
    unnamed: tuple[str, ...] = ()
    false: tuple[str, ...] = ()


def judge(trial: Trial) -> Verdict:
    """Score what a trial said against what is truly wrong with it."""
    if trial.mode in ("refused", "stopped", "crashed"):
        return Verdict(CRASH if trial.mode == "crashed" else NONE)
    wrong = trial.mode != "ok" or bool(trial.causes)
    causes = trial.causes or ((ACCURACY,) if wrong else ())
    claims = [claim(sentence) for sentence in trial.told]
    named = {each.cause for each in claims}
    for bar in trial.bars:  # one that holds tells the error itself
        if bar.holds:
            named |= {ACCURACY} if bar.what == "mesh" else set(CAUSES)
    unnamed = tuple(cause for cause in causes if cause not in named)
    about_right = any(bar.ratio >= 1 / WIDE for bar in trial.bars)
    false = []
    for each in claims:
        if each.cause in CAUSES and each.cause not in (*causes, *trial.partly):
            larger_cause = each.cause == ACCURACY and trial.mode != "ok"
            if not (each.stated and about_right or larger_cause):
                false.append(each.cause)
    if any(not bar.holds for bar in trial.bars):
        outcome = BAR
    elif unnamed:
        outcome = SILENT
    elif wrong:
        outcome = SAID
    else:
        outcome = ALARM if false else RIGHT
    return Verdict(outcome, unnamed, tuple(dict.fromkeys(false)))


def counts(trials: Sequence[Trial]) -> dict[str, Any]:
    """For a row of a table: trials by outcome and by mode, false alarms among all, bars that hold."""
    verdicts = [judge(trial) for trial in trials]
    bars = [bar for trial in trials for bar in trial.bars]
    ratios = sorted(bar.ratio for bar in bars)
    errors = sorted(trial.error for trial in trials if trial.mode == "ok" and trial.error is not None)
    right = sum(verdict.outcome in (RIGHT, ALARM) for verdict in verdicts)
    low, high = wilson(right, len(trials))
    return {
        "trials": len(trials),
        **{outcome: sum(verdict.outcome == outcome for verdict in verdicts) for outcome in OUTCOMES},
        "with a false alarm": sum(bool(verdict.false) for verdict in verdicts),
        "bars": len(bars), "bars that hold": sum(bar.holds for bar in bars),
        "median ratio": ratios[len(ratios) // 2] if ratios else None,
        "worst ratio": max((bar.worst for bar in bars), default=None),
        "least coverage": min((bar.coverage for bar in bars), default=None),
        "median error": errors[len(errors) // 2] if errors else None, "from": low, "to": high,
        **{f"mode {mode}": sum(trial.mode == mode for trial in trials) for mode in MODES},
    }  # fmt: skip
