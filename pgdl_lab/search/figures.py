"""Figures of a study: history, importances, each setting, parallel coordinates and, for two objectives, the front."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import optuna
from optuna.trial import FrozenTrial, TrialState

from pgdl_lab.assessment.figures import STYLE
from pgdl_lab.core.files import replacing
from pgdl_lab.search.settings import MISFIT
from pgdl_lab.search.tally import LOST

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNITS = {"mm2": "mm²", "mm": "mm", "ms": "ms", "seconds": "s", MISFIT: "tolerances"}
"""What the first part of a metric's name ends with, and the unit that it stands for."""
FEWEST = 4  # complete trials that say something about importances
FEW = 5  # different numbers that are all told on an axis
LACKING = -0.1  # where a line passes that has no such setting
DENSE = 500.0  # the same up to which it has three labels per decade
RATIO = 20.0  # greatest over least value from which on an axis is logarithmic


def draw(study: optuna.Study, objectives: Mapping[str, str], folder: Path) -> list[Path]:
    """Write the figures of `study` to `folder`.

    Parameters
    ----------
    study
        The study.
    objectives
        Names and directions, in the order of the trials' values.
    folder
        Where the PNG files go.
    """
    import matplotlib
    from matplotlib.figure import Figure

    trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if not trials:
        return []
    importances = _importances(study) if len(trials) >= FEWEST else []
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with matplotlib.rc_context(STYLE):
        figures: dict[str, Figure] = {}

        def new(name: str, panels: int, width: float, height: float, columns: int | None = None) -> list[Axes]:
            """Panels of this size [in], beside each other or in rows of so many columns."""
            columns = min(columns or panels, panels)
            rows = -(-panels // columns)
            figures[name] = Figure(figsize=(width * columns, height * rows), layout="constrained")
            axes: list[Axes] = figures[name].subplots(rows, columns, squeeze=False).ravel().tolist()
            for axis in axes[panels:]:
                axis.remove()
            return axes[:panels]

        _history(new("history", len(objectives), 6.5, 4), study, objectives)
        names = sorted({name for trial in trials for name in trial.params})
        pruned = study.get_trials(deepcopy=False, states=(TrialState.PRUNED,))
        panels = new("settings", len(names), 3.4, 3.8, columns=4)
        _slices(panels, trials, pruned, names, with_unit(next(iter(objectives))))
        if any(importances):
            _bars(new("importances", len(objectives), 6.5, 4), importances, list(objectives))
        _parallel(new("parallel_coordinates", 1, 1.7 * (len(names) + 1), 4.5)[0], trials, names, objectives)
        if len(objectives) > 1:
            pairs = [(0, other) for other in range(1, len(objectives))]
            axes = new("pareto", len(pairs), 6.5, 5)
            for axis, pair in zip(axes, pairs, strict=True):
                _pareto(axis, trials, study.best_trials, list(objectives), pair)
        for name, figure in figures.items():
            path = folder / f"{name}.png"
            with replacing(path) as temporary:
                figure.savefig(temporary, format="png")
            written.append(path)
    return written


def with_unit(objective: str) -> str:
    """Name of an objective with its unit, for an axis."""
    first = objective.partition("+")[0].partition(".")[0]
    unit = UNITS.get(first.rpartition("_")[2])
    return objective.replace("+", " + ") + (f" [{unit}]" if unit else "")


def _importances(study: optuna.Study) -> list[dict[str, float]]:
    """Share of each setting in what makes the trials differ, for each objective; empty where nothing differs."""
    found = []
    for index, direction in enumerate(study.directions):
        sign = 1.0 if direction is optuna.study.StudyDirection.MINIMIZE else -1.0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that low values count as good, which the sign sees to
            try:
                found.append(optuna.importance.get_param_importances(study, target=partial(_value, index, sign)))
            except (RuntimeError, ValueError):  # all trials have the same value, or the same settings
                found.append({})
    return found


def _value(index: int, sign: float, trial: FrozenTrial) -> float:
    return sign * trial.values[index]


def _history(axes: Sequence[Axes], study: optuna.Study, objectives: Mapping[str, str]) -> None:
    trials = study.get_trials(deepcopy=False)
    for index, (axis, (name, direction)) in enumerate(zip(axes, objectives.items(), strict=True)):
        done = [trial for trial in trials if trial.state is TrialState.COMPLETE]
        numbers, values = [trial.number for trial in done], [trial.values[index] for trial in done]
        best = (np.minimum if direction == "minimize" else np.maximum).accumulate(values)
        axis.plot(numbers, values, "o", ms=4, label="complete")
        axis.step(numbers, best, where="post", color="0.3", label="best so far")
        for state, mark, label in ((TrialState.PRUNED, "|", "pruned"), (TrialState.FAIL, "x", "failed")):
            others = [trial.number for trial in trials if trial.state is state and LOST not in trial.user_attrs]
            if others:
                axis.plot(others, [max(values)] * len(others), mark, color="tab:red", ms=7, label=label)
        _scale(axis, "y", values)
        axis.set(xlabel="trial", ylabel=with_unit(name))
        axis.legend()


def _bars(axes: Sequence[Axes], importances: Sequence[Mapping[str, float]], names: Sequence[str]) -> None:
    for axis, shares, name in zip(axes, importances, names, strict=True):
        axis.barh(list(shares)[::-1], list(shares.values())[::-1])
        axis.set(xlabel="importance", title=with_unit(name))


def _slices(
    axes: Sequence[Axes],
    trials: Sequence[FrozenTrial],
    pruned: Sequence[FrozenTrial],
    names: Sequence[str],
    objective: str,
) -> None:
    """The first objective over each setting, later trials darker; those that were pruned are marked above."""
    for axis, name in zip(axes, names, strict=True):
        if axis is not axes[0]:
            axis.sharey(axes[0])
        mine, cut = ([t for t in some if name in t.params] for some in (trials, pruned))
        values = [trial.params[name] for trial in mine]
        if _numeric(values):
            _scale(axis, "x", values, logarithmic=getattr(mine[0].distributions[name], "log", False))
            places = values
            above = [trial.params[name] for trial in cut]
        else:
            kinds = sorted({str(trial.params[name]) for trial in (*mine, *cut)})
            places = [kinds.index(str(value)) for value in values]
            above = [kinds.index(str(trial.params[name])) for trial in cut]
            axis.set_xticks(range(len(kinds)), kinds, rotation=15)
            axis.margins(x=0.2)
        shades = [trial.number for trial in mine]
        axis.scatter(places, [trial.values[0] for trial in mine], c=shades, cmap="viridis_r", s=18, zorder=3)
        axis.plot(above, [1.0] * len(above), "|", color="tab:red", ms=7, transform=axis.get_xaxis_transform())
        axis.set(xlabel=name)
        _scale(axis, "y", [trial.values[0] for trial in trials])
        place = axis.get_subplotspec()
        if place is None or place.is_first_col():
            axis.set_ylabel(objective)
        else:
            axis.tick_params(labelleft=False)


def _parallel(axis: Axes, trials: Sequence[FrozenTrial], names: Sequence[str], objectives: Mapping[str, str]) -> None:
    """One line per trial over its settings, ending at its first objective, which also gives its colour."""
    import matplotlib

    columns = [_unit([trial.params.get(name) for trial in trials]) for name in names]
    ends, ticks = _unit([trial.values[0] for trial in trials])
    heights = np.column_stack([*(column for column, _ in columns), ends])
    colours = matplotlib.colormaps["viridis"]
    for line, end in sorted(zip(heights, ends, strict=True), key=lambda each: -each[1]):
        axis.plot(line, color=colours(end), lw=1.2, marker="o", ms=3)
    behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
    for place, labels in enumerate([*(labels for _, labels in columns), ticks]):
        axis.axvline(place, color="0.8", zorder=0)
        for height, told in labels.items():
            axis.text(place + 0.04, height, told, fontsize=8, va="center", bbox=behind, zorder=3)
    axis.set_xticks(range(len(names) + 1), [*names, with_unit(next(iter(objectives)))], rotation=15, ha="right")
    axis.tick_params(axis="x", length=0)
    axis.spines[["left", "bottom"]].set_visible(False)
    axis.set_yticks([])
    axis.set_xlim(-0.1, len(names) + 0.5)


def _numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _spread(values: Sequence[float]) -> bool:
    """Whether values spread too widely for an even axis."""
    return min(values) > 0 and max(values) / min(values) > RATIO


def _unit(values: Sequence[Any]) -> tuple[np.ndarray, dict[float, str]]:
    """Values placed from 0 to 1, and the labels of places; settings that a trial lacks lie below."""
    there = [value for value in values if value is not None]
    if _numeric(there):
        scaled = {value: float(np.log(value)) if _spread(there) else float(value) for value in there}
        low, span = min(scaled.values()), (max(scaled.values()) - min(scaled.values())) or 1.0
        places: dict[Any, float] = {value: (scaled[value] - low) / span for value in there}
        few = sorted(places) if len(places) <= FEW else [min(there), max(there)]
        labels = {places[value]: f"{value:.3g}" for value in few}
    else:
        kinds = sorted({str(value) for value in there})
        places = {value: kinds.index(str(value)) / max(len(kinds) - 1, 1) for value in there}
        labels = {place: str(value) for value, place in places.items()}
    if len(there) < len(values):
        labels[LACKING] = "none"
    return np.array([places.get(value, LACKING) for value in values]), labels


def _pareto(
    axis: Axes,
    trials: Sequence[FrozenTrial],
    front: Sequence[FrozenTrial],
    names: Sequence[str],
    pair: tuple[int, int],
) -> None:
    y, x = pair
    axis.plot([t.values[x] for t in trials], [t.values[y] for t in trials], "o", color="0.7", ms=5, label="trials")
    ordered = sorted(front, key=lambda trial: trial.values[x])
    across, up = [trial.values[x] for trial in ordered], [trial.values[y] for trial in ordered]
    axis.step(across, up, where="post", color="tab:blue", lw=1)
    axis.plot(across, up, "o", color="tab:blue", ms=6, label="Pareto front")
    for trial in ordered:
        axis.annotate(
            str(trial.number), (trial.values[x], trial.values[y]), (4, 4), textcoords="offset points", fontsize=8
        )
    _scale(axis, "x", [trial.values[x] for trial in trials])
    _scale(axis, "y", [trial.values[y] for trial in trials])
    axis.set(xlabel=with_unit(names[x]), ylabel=with_unit(names[y]))
    axis.legend()


def _scale(axes: Axes, which: str, values: Sequence[float], logarithmic: bool = False) -> None:
    """Make an axis logarithmic where that is asked for or the values spread widely."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    if logarithmic or _spread(values):
        axes.set(**{f"{which}scale": "log"})
        axis = getattr(axes, f"{which}axis")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if max(values) < DENSE * min(values) else (1.0,)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
