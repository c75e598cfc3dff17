"""The failure map: one figure and one page to read, silent failures first."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pgdl_lab.files import replacing
from pgdl_lab.stability.outcome import GOOD, STALLED, Cell, Trial, cells

PARTS = ("mechanics", "learning")


def draw(trials: Sequence[Trial], path: Path) -> None:
    """Write the map as a PNG: methods by axes, the colour is the success rate, a red frame marks silent failures."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = cells(trials)
    parts = [part for part in PARTS if any(trial.part == part for trial in trials)]
    size = (12, 1.2 + 3.2 * len(parts))
    figure, panels = plt.subplots(len(parts), 1, figsize=size, layout="constrained", squeeze=False)
    for panel, part in zip(panels[:, 0], parts, strict=True):
        ours = [trial for trial in trials if trial.part == part]
        axes, methods = (list(dict.fromkeys(getattr(trial, what) for trial in ours)) for what in ("axis", "method"))
        _map(panel, {key: cell for key, cell in found.items() if cell.trials[0].part == part}, axes, methods)
        panel.set_title(f"{part}: successes of trials, median error of the successes")
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=140)
    plt.close(figure)


def _map(panel: Any, found: dict[tuple[str, str], Cell], axes: list[str], methods: list[str]) -> None:
    from matplotlib import colormaps
    from matplotlib.patches import Rectangle

    colours = colormaps["RdYlGn"]
    for (method, axis), cell in found.items():
        record, x, y = cell.record(), axes.index(axis), methods.index(method)
        panel.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, color=colours(0.15 + 0.7 * record["success_rate"])))
        if cell.silent:
            panel.add_patch(Rectangle((x - 0.46, y - 0.44), 0.92, 0.88, fill=False, ec="red", lw=2.5, zorder=3))
        text = f"{cell.ok}/{len(cell.trials)}"
        text += f"\n{record['median_error']:.1%}" if record["median_error"] is not None else ""
        text += f"\n{cell.silent} silent" if cell.silent else ""
        panel.text(x, y, text, ha="center", va="center", fontsize=8)
    panel.set(xlim=(-0.5, len(axes) - 0.5), ylim=(len(methods) - 0.5, -0.5))
    panel.set_xticks(range(len(axes)), [axis.replace(" ", "\n", 1) for axis in axes], fontsize=8)
    panel.set_yticks(range(len(methods)), methods)
    panel.spines[:].set_visible(False)
    panel.tick_params(length=0)


def write_page(trials: Sequence[Trial], path: Path) -> None:
    """Write the page as Markdown."""
    silent = [trial for trial in trials if trial.silent]
    lines = [
        "# Failure map",
        "",
        f"A success errs by at most {GOOD:.0%}; a learnt model that errs by more than {STALLED:.0%} has stalled. What",
        "errs more and was given without a warning is silently wrong. Intervals are Wilson's, of 95 %.",
        "",
        f"## Silently wrong: {len(silent)} of {len(trials)} trials",
        "",
    ]
    lines += [
        f"- **{trial.method}**, {trial.axis}, {trial.level}: {trial.mode}"
        + (f", errs by {trial.error:.1%}" if trial.error is not None else "")
        for trial in silent
    ] or ["None."]
    lines += ["", "## Success rates", "", "| method | axis | successes | 95 % | median error | how the others ended |"]
    lines += ["| --- | --- | --- | --- | --- | --- |"]
    for (method, axis), cell in cells(trials).items():
        record = cell.record()
        error = "–" if record["median_error"] is None else f"{record['median_error']:.2%}"
        others = {mode: sum(trial.mode == mode for trial in cell.trials) for mode in ("wrong", "stalled", "stopped")}
        others |= {mode: record[mode] for mode in ("not a number", "crashed")}
        told = ", ".join(f"{count} {mode}" for mode, count in others.items() if count)
        told += f" ({cell.silent} without a word)" if cell.silent else ""
        interval = f"{record['from']:.0%} … {record['to']:.0%}"
        lines.append(f"| {method} | {axis} | {cell.ok} of {len(cell.trials)} | {interval} | {error} | {told} |")
    lines += ["", "## What was said", ""]
    lines += [
        f"- {trial.method}, {trial.axis}, {trial.level}: {trial.mode}. {trial.told}"
        for trial in trials
        if trial.mode != "ok" and trial.told
    ]
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
