"""The failure map: one figure and one page to read, silent failures first."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pgdl_lab.files import replacing
from pgdl_lab.stability.outcome import GOOD, MODES, STALLED, Cell, Trial, cells

PARTS = ("mechanics", "learning")
REFUSED = "0.8"  # colour of a cell whose trials were all refused
NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?")


def draw(trials: Sequence[Trial], path: Path) -> None:
    """Write the map as a PNG: methods by axes, the colour is the success rate, a red frame marks silent failures."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = cells(trials)
    parts = [part for part in PARTS if any(trial.part == part for trial in trials)]
    listed = {part: _names([trial for trial in trials if trial.part == part]) for part in parts}
    rows = [len(methods) for _, methods in listed.values()]
    figure, panels = plt.subplots(
        len(parts), 1, figsize=(12, 1.2 * len(parts) + 0.6 * sum(rows)), layout="constrained", squeeze=False,
        height_ratios=rows,
    )  # fmt: skip
    for panel, part in zip(panels[:, 0], parts, strict=True):
        _map(panel, {key: cell for key, cell in found.items() if cell.trials[0].part == part}, *listed[part])
        panel.set_title(
            f"{part}: successes of trials and their median error; how the others ended", loc="left", fontsize=10
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=140)
    plt.close(figure)


def _names(trials: Sequence[Trial]) -> tuple[list[str], list[str]]:
    """Axes and methods, in the order of the trials and by name."""
    return list(dict.fromkeys(trial.axis for trial in trials)), sorted({trial.method for trial in trials})


def _map(panel: Any, found: dict[tuple[str, str], Cell], axes: list[str], methods: list[str]) -> None:
    from matplotlib import colormaps
    from matplotlib.patches import Rectangle

    colours = colormaps["RdYlGn"]
    for (method, axis), cell in found.items():
        record, x, y = cell.record(), axes.index(axis), methods.index(method)
        refused = record["refused"] == len(cell.trials)
        colour = REFUSED if refused else colours(0.15 + 0.7 * record["success_rate"])
        panel.add_patch(Rectangle((x - 0.48, y - 0.47), 0.96, 0.94, color=colour, lw=0))
        if cell.silent:
            panel.add_patch(Rectangle((x - 0.46, y - 0.44), 0.92, 0.88, fill=False, ec="red", lw=2.5, zorder=3))
        text = f"{cell.ok}/{len(cell.trials)}"
        text += f", {record['median_error']:.1%}" if record["median_error"] is not None else ""
        text += "".join(f"\n{record[mode]} {mode}" for mode in MODES[1:] if record[mode])
        text += f"\n{cell.silent} SILENT" if cell.silent else ""
        panel.text(x, y, text, ha="center", va="center", fontsize=7.5, linespacing=1.1)
    panel.set(xlim=(-0.5, len(axes) - 0.5), ylim=(len(methods) - 0.5, -0.5))
    panel.set_xticks(range(len(axes)), [axis.replace(" ", "\n", 1) for axis in axes], fontsize=8)
    panel.set_yticks(range(len(methods)), methods, fontsize=9)
    panel.spines[:].set_visible(False)
    panel.tick_params(length=0)


def write_page(trials: Sequence[Trial], head: Sequence[str], path: Path) -> None:
    """Write the page as Markdown; `head` are lines that say how the trials were made."""
    silent = [trial for trial in trials if trial.silent]
    lines = [
        "# Failure map",
        "",
        *head,
        "",
        f"A success errs by at most {GOOD:.0%}; a learnt model that errs by more than {STALLED:.0%} has stalled. What",
        "errs more and was given without a warning is silently wrong. What is not possible is refused (grey). An empty",
        "field: the stress does not reach the method. Intervals are Wilson's, of 95 %.",
        "",
        "![Successes of every method under every stress](figures/stability.png)",
        "",
        f"## Silently wrong: {len(silent)} of {len(trials)} trials",
        "",
    ]
    lines += [
        f"- **{trial.method}**, {trial.axis}, {trial.level}: {trial.mode}"
        + (f", errs by {trial.error:.1%}" if trial.error is not None else "")
        for trial in silent
    ] or ["None."]
    lines += ["", "## Methods", "", f"| method | trials | {' | '.join(MODES)} | silently |", "| --- " * 10 + "|"]
    for part in PARTS:
        for method in _names([trial for trial in trials if trial.part == part])[1]:
            ours = Cell([trial for trial in trials if (trial.part, trial.method) == (part, method)])
            counts = [str(ours.record()[mode]) for mode in MODES]
            lines.append(f"| {method} | {len(ours.trials)} | {' | '.join(counts)} | {ours.silent} |")
    lines += ["", "## Success rates", "", "| method | axis | successes | 95 % | median error | how the others ended |"]
    lines += ["| --- | --- | --- | --- | --- | --- |"]
    for (method, axis), cell in cells(trials).items():
        record = cell.record()
        error = "–" if record["median_error"] is None else f"{record['median_error']:.2%}"
        told = ", ".join(f"{record[mode]} {mode}" for mode in MODES[1:] if record[mode])
        told += f" ({cell.silent} without a word)" if cell.silent else ""
        interval = f"{record['from']:.0%} … {record['to']:.0%}"
        lines.append(f"| {method} | {axis} | {cell.ok} of {len(cell.trials)} | {interval} | {error} | {told} |")
    lines += ["", "## What was said where a method did not succeed", ""]
    lines += [f"- {line}" for line in _said(trials)]
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _said(trials: Sequence[Trial]) -> list[str]:
    """Each message once, the most frequent first, with the methods that gave it; numbers are those of the first."""
    alike: dict[str, list[Trial]] = {}
    for trial in trials:
        if trial.mode != "ok" and trial.told:
            alike.setdefault(NUMBER.sub("#", trial.told), []).append(trial)
    groups = sorted(alike.values(), key=lambda group: -len(group))
    return [
        f"{len(group)} × {', '.join(sorted({trial.method for trial in group}))} (first: {group[0].axis}, "
        f"{group[0].level}; {group[0].mode}): {group[0].told}"
        for group in groups
    ]
