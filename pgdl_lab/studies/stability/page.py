"""The failure map as a page to read: what went wrong without a word first."""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from pgdl_lab.core.files import replacing
from pgdl_lab.studies.stability.claims import NUMBER, UNKNOWN, claim
from pgdl_lab.studies.stability.figure import PARTS
from pgdl_lab.studies.stability.outcome import CAUSES, CONTACT, COVERED, GOOD, MODES, STALLED, WIDE, Trial, cells
from pgdl_lab.studies.stability.verdict import BAR, CRASH, MEANING, OUTCOMES, SILENT, counts, judge

WORDS = {**CAUSES, CONTACT: "surfaces touch or pass through each other"}
LISTED = 15  # trials of a kind; of more, how many there are
HOW = f"""
A right result errs by at most {GOOD:.0%}; a surrogate that errs by more than {STALLED:.0%} has stalled.
A warning counts only if it says what is wrong: every cause that was measured must be named. What is warned of and is
not there is a false alarm. A number that a method states counts by whether it holds, whatever else was said: of the
change on a mesh with half the edges, that the true error at the tip is at most {WIDE:g} times as large; of error bars
that promise 95 %, that they cover at least {COVERED:.0%} of the errors, at points which no model has seen. Nothing
is left out: a trial that gave no result or crashed counts as such.

Finite elements are compared with half the body on a mesh of 2.2 mm (4.4 mm for the ceiling and for ten chambers), and
with the whole body on one of 4.4 mm, which a pull across of 1/10,000 of its weight lets lean; errors are relative to
the largest displacement. What leans by less than {GOOD:.0%} of that does not count as unstable. Whether
surfaces pass through each other is seen from elements that overlap by 0.05 mm and more, not from contact.
Surrogates are compared with the simulation that they learnt from, relative to the root mean square of its displacement;
what is wrong is told by where they err: at the training points, between them, or beyond their pressures.
"""


def write_page(trials: Sequence[Trial], head: Sequence[str], path: Path) -> None:
    """Write the page as Markdown; `head` are lines that say how the trials were made."""
    lines = ["# Failure map", "", *head, *HOW.splitlines(), ""]
    lines += ["![How honest each method was under each stress](figures/stability.png)", ""]
    for outcome in (SILENT, BAR, CRASH):
        lines += [*_listed(outcome, trials), ""]
    lines += ["## Methods", "", *_table(trials, lambda each: (each.method,)), ""]
    lines += ["## Stresses", "", *_table(trials, lambda each: (each.method, each.axis)), ""]
    lines += ["## How each result ended, whatever was said", "", *_ends(trials), ""]
    lines += ["## What was said, and whether it was so", "", *_said(trials)]
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _listed(outcome: str, trials: Sequence[Trial]) -> list[str]:
    found = [(trial, judge(trial)) for trial in trials if judge(trial).outcome == outcome]
    lines = [f"## {outcome[0].upper()}{outcome[1:]}: {len(found)} of {len(trials)} trials", ""]
    lines += [f"{MEANING[outcome].capitalize()}.", ""]
    groups: dict[tuple[str, str, str], list[Trial]] = {}
    for trial, verdict in found:
        what = ", ".join(WORDS[cause] for cause in verdict.unnamed) if outcome == SILENT else ""
        groups.setdefault((trial.method, trial.axis, what), []).append(trial)
    ordered = sorted(groups.items(), key=lambda group: -len(group[1]))
    for (method, axis, what), group in ordered[:LISTED]:
        levels = "; ".join(dict.fromkeys(trial.level for trial in group))
        errors = [trial.error for trial in group if trial.error is not None]
        ratios = [bar.worst for trial in group for bar in trial.bars if not bar.holds]
        told = f"; errs by up to {max(errors):.1%}" if errors else ""
        told += f"; the worst error is {max(ratios):.3g} times what was stated" if outcome == BAR else ""
        told += f"; {group[0].told[0]}" if outcome == CRASH else ""
        lines.append(f"- {len(group)} × **{method}**, {axis} ({levels}){': ' if what else ''}{what}{told}")
    if more := sum(len(group) for _, group in ordered[LISTED:]):
        lines.append(f"- and {more} more, see the table of stresses")
    return lines if found else [*lines[:2], "None."]


def _table(trials: Sequence[Trial], key: Callable[[Trial], tuple[str, ...]]) -> Iterable[str]:
    groups: dict[tuple[str, ...], list[Trial]] = {}
    for part in PARTS:
        for trial in sorted((each for each in trials if each.part == part), key=lambda each: each.method):
            groups.setdefault(key(trial), []).append(trial)
    names = ("method", "stress")[: len(next(iter(groups)))]
    yield (
        f"| {' | '.join(names)} | trials | {' | '.join(OUTCOMES)} | with a false alarm | bars that hold | "
        "median ratio | worst ratio | least coverage | median error when right |"
    )
    yield "| --- " * (len(names) + 1 + len(OUTCOMES) + 6) + "|"
    for name, group in groups.items():
        row = counts(group)
        bars = f"{row['bars that hold']} of {row['bars']}" if row["bars"] else "–"
        numbers = [_number(row["median ratio"], "{:.2g}"), _number(row["worst ratio"], "{:.3g}")]
        numbers += [_number(row["least coverage"], "{:.0%}"), _number(row["median error"], "{:.2%}")]
        outcomes = " | ".join(str(row[outcome]) for outcome in OUTCOMES)
        yield (
            f"| {' | '.join(name)} | {row['trials']} | {outcomes} | {row['with a false alarm']} | {bars} | "
            f"{' | '.join(numbers)} |"
        )


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(value)


def _ends(trials: Sequence[Trial]) -> Iterable[str]:
    yield f"| method | stress | right | 95 % | {' | '.join(MODES)} |"
    yield "| --- " * (4 + len(MODES)) + "|"
    for (method, axis), group in cells(trials).items():
        row = counts(group)
        right = row["right"] + row["right, false alarm"]
        ends = " | ".join(str(row[f"mode {mode}"]) for mode in MODES)
        yield f"| {method} | {axis} | {right} of {len(group)} | {row['from']:.0%} … {row['to']:.0%} | {ends} |"


def _said(trials: Sequence[Trial]) -> Iterable[str]:
    """Each warning once, the most frequent first; numbers are those of the first."""
    alike: dict[str, list[tuple[Trial, str]]] = {}
    for trial in trials:
        for sentence in trial.told:
            alike.setdefault(re.sub(NUMBER, "#", sentence), []).append((trial, sentence))
    for group in sorted(alike.values(), key=lambda group: -len(group)):
        first, sentence = group[0]
        given = [trial for trial, _ in group if trial.mode not in ("refused", "stopped", "crashed")]
        cause, false = claim(sentence).cause, sum(claim(sentence).cause in judge(trial).false for trial in given)
        verdict = f"false in {false} of {len(given)}; " if cause in CAUSES and given else ""
        verdict += "no rule tells what it claims; " if cause == UNKNOWN and given else ""
        methods = ", ".join(sorted({trial.method for trial, _ in group}))
        yield f"- {len(group)} × {methods} ({verdict}first: {first.axis}, {first.level}; {first.mode}): {sentence}"
