"""The failure map as a figure: a mark for each trial, whose shape and colour tell how honest it was."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pgdl_lab.core.files import replacing
from pgdl_lab.studies.stability.outcome import Trial
from pgdl_lab.studies.stability.verdict import ALARM, BAR, CRASH, MEANING, NONE, OUTCOMES, RIGHT, SAID, SILENT, judge

PARTS = ("mechanics", "learning")
WIDTH_IN, DPI = 9.0, 200  # 900 pixels at 100 dots per inch, drawn twice as fine
STEP_IN = 0.17  # from mark to mark
# shape and colour of each outcome: shapes alone tell them apart, and colours are those of Okabe and Ito
MARKS = {
    RIGHT: ("o", "#009e73"),
    ALARM: ("^", "#56b4e9"),
    SAID: ("s", "#e69f00"),
    BAR: ("D", "#cc79a7"),
    SILENT: ("X", "#d5202a"),
    NONE: ("_", "#666666"),
    CRASH: ("*", "#000000"),
}


def draw(trials: Sequence[Trial], path: Path) -> None:
    """Write the map as a PNG: stresses by methods; in each field levels go from left to right, seeds from top down."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    parts = [[trial for trial in trials if trial.part == part] for part in PARTS]
    parts = [part for part in parts if part]
    heights = [sum(1.6 + _rows(part, axis) for axis in _axes(part)) for part in parts]
    inches = STEP_IN * sum(heights) + 0.75 * len(parts) + 1.2
    figure, panels = plt.subplots(
        len(parts), 1, figsize=(WIDTH_IN, inches), layout="constrained", squeeze=False, height_ratios=heights
    )
    for panel, part in zip(panels[:, 0], parts, strict=True):
        _panel(panel, part)
    figure.legend(handles=[_handle(outcome, trials) for outcome in OUTCOMES], loc="outside lower left", ncols=2,
                  fontsize=9.5, frameon=False, title="a mark is a trial; from left to right the stress grows",
                  title_fontsize=9.5, alignment="left")  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI)
    plt.close(figure)


def _axes(part: Sequence[Trial]) -> list[str]:
    return list(dict.fromkeys(trial.axis for trial in part))


def _rows(part: Sequence[Trial], axis: str) -> int:
    return 1 + max(trial.seed for trial in part if trial.axis == axis)


def _panel(panel: Any, part: Sequence[Trial]) -> None:
    methods, axes = sorted({trial.method for trial in part}), _axes(part)
    levels = {axis: list(dict.fromkeys(trial.level for trial in part if trial.axis == axis)) for axis in axes}
    widest = 1.5 + max(map(len, levels.values()))
    top, ticks = 0.0, []
    for axis in axes:
        rows = _rows(part, axis)
        ticks.append(top + rows / 2)
        for trial in (trial for trial in part if trial.axis == axis):
            x = methods.index(trial.method) * widest + levels[axis].index(trial.level) + 0.5
            shape, colour = MARKS[judge(trial).outcome]
            line = {"lw": 2.2} if shape == "_" else {"lw": 0.4, "ec": "black"}
            panel.scatter(x, top + trial.seed + 0.5, marker=shape, s=62, color=colour, zorder=2, **line)
        top += rows + 1.6
        panel.axhline(top - 0.8, color="0.85", lw=0.8, zorder=1)
    for number in range(1, len(methods)):
        panel.axvline(number * widest - 0.75, color="0.85", lw=0.8, zorder=1)
    panel.set(xlim=(-0.75, len(methods) * widest - 0.75), ylim=(top - 0.8, -0.8))
    panel.set_yticks(ticks, axes, fontsize=10)
    names = [name.replace("_", "\n") for name in methods]
    panel.set_xticks([(number + 0.5) * widest - 0.75 for number in range(len(methods))], names, fontsize=10)
    panel.xaxis.tick_top()
    panel.tick_params(length=0)
    panel.spines[:].set_color("0.85")
    title = "Finite elements under stress" if part[0].part == "mechanics" else "Surrogates under stress"
    panel.set_title(title, loc="left", fontsize=11.5, fontweight="bold", x=-0.2)


def _handle(outcome: str, trials: Sequence[Trial]) -> Any:
    from matplotlib.lines import Line2D

    shape, colour = MARKS[outcome]
    count = sum(judge(trial).outcome == outcome for trial in trials)
    edge = {"markeredgewidth": 2.2} if shape == "_" else {"markeredgecolor": "black", "markeredgewidth": 0.4}
    label = f"{count} × {MEANING[outcome]}"
    return Line2D([], [], marker=shape, color=colour, linestyle="", markersize=8, label=label, **edge)
