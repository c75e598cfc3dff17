"""What a study leaves behind: a table of its trials, figures, and configurations that run again."""

from __future__ import annotations

import csv
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from optuna.trial import FrozenTrial, TrialState
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pgdl_lab.core.files import replacing
from pgdl_lab.running.folders import BEST
from pgdl_lab.search import figures
from pgdl_lab.search.best import write_experiment
from pgdl_lab.search.settings import SELECTION_MM2
from pgdl_lab.search.study import ERROR, SCHEMA, SharedStudy
from pgdl_lab.search.tally import LOST

_log = logging.getLogger(__name__)
SHOWN = 10  # rows of the table on the terminal
OTHERS = 3  # seeds that tell what the best is worth


def report(shared: SharedStudy) -> list[Path]:
    """Write trials.csv, figures and the best configurations, and show the best trials.

    Returns
    -------
    The files and folders written.
    """
    study, folder, objectives = shared.study, shared.folder, shared.settings.directions
    written = [_csv(shared.trials(), list(objectives), folder / "trials.csv")]
    best = _best(shared)
    try:
        written += figures.draw(study, objectives, folder / "figures")
    except Exception as error:  # a full disk or a font: the trials are done
        _log.warning("The figures of the study could not be drawn: %s", error)
    several = len(objectives) > 1
    configurations = BEST / shared.settings.study
    for old in configurations.glob("*.yaml"):
        old.unlink()
    for place, trial in enumerate(best, start=1):
        path = configurations / (f"pareto_{place}.yaml" if several else "best.yaml")
        values = ", ".join(f"{name} {value:.4g}" for name, value in zip(objectives, trial.values, strict=True))
        comment = f"Trial {trial.number} of the study {shared.settings.study}: {values}{_tested(shared, trial)}"
        write_experiment(folder / str(trial.number), path, comment)
        written.append(path)
    if several and best:
        written.append(_csv(best, list(objectives), folder / "pareto.csv"))
    Console().print(_table(shared, best))
    for trial in shared.failed():
        _log.warning("Trial %d failed: %s", trial.number, trial.user_attrs.get(ERROR))
    complete = shared.trials(TrialState.COMPLETE)
    if len(complete) > 1 and len({tuple(trial.values) for trial in complete}) == 1:
        _log.warning(
            "All %d trials have the same values, so what was searched makes no difference. Trainings that gain nothing "
            "surely keep the state before the first step: trainer.validation=0 keeps the last one.",
            len(complete),
        )
    if best:
        file = "pareto_1" if several else "best"
        again = f"experiment={shared.settings.study}/{file}"
        _log.info("The best runs again by: python -m pgdl_lab %s", again)
        if told := _tested(shared, best[0]):
            _log.info("It is trial %d%s", best[0].number, told)
        _log.info("%s", mesh_error(folder / str(best[0].number)))
        same = study.user_attrs[SCHEMA]["setting"]
        if same.get("task") == "train" and "seed" in same:
            others = ",".join(str(same["seed"] + number) for number in range(1, OTHERS + 1))
            text = "Its value is the least of %d, in part by luck; what it is worth: python -m pgdl_lab -m %s seed=%s"
            _log.info(text, len(complete), again, others)
    _log.info("Everything of this study is in %s", folder)
    return written


def _best(shared: SharedStudy) -> list[FrozenTrial]:
    """The best trial, or those of the Pareto front by their first objective."""
    if not shared.trials(TrialState.COMPLETE):
        return []
    return sorted(shared.study.best_trials, key=lambda trial: trial.values[0])[: None if _several(shared) else 1]


def _tested(shared: SharedStudy, trial: FrozenTrial) -> str:
    """The error of a trial at points that no trial was selected by, if it was selected by others."""
    file = shared.folder / str(trial.number) / "metrics.json"
    if not any(SELECTION_MM2 in name for name in shared.settings.directions) or not file.is_file():
        return ""
    mse = json.loads(file.read_text(encoding="utf-8"))["mse_mm2"]
    return f"; over the test points, which nothing was selected by, MSE x {mse['x']:.4g}, z {mse['z']:.4g} mm²"


def mesh_error(trial: Path) -> str:
    """How far off the simulation of a trial is, which no value of the trial counts, in a sentence."""
    file = trial / "metrics.json"
    found = json.loads(file.read_text(encoding="utf-8")).get("discretisation_error") if file.is_file() else None
    if found is None:
        return "The error of its mesh is not known: nothing estimated it."
    return (
        f"Its simulation would have the tip {found['tip_mm']:.2g} mm elsewhere at {found['kpa']:.4g} kPa on half the "
        "edges; that is no part of the values above."
    )


def _several(shared: SharedStudy) -> bool:
    return len(shared.settings.objectives) > 1


def _table(shared: SharedStudy, best: Sequence[FrozenTrial]) -> Table:
    """The Pareto front, or the best trials."""
    objectives, complete = shared.settings.directions, shared.trials(TrialState.COMPLETE)
    rows = list(best)
    if not _several(shared):
        sign = 1 if list(objectives.values()) == ["minimize"] else -1
        rows = sorted(complete, key=lambda trial: sign * trial.values[0])[:SHOWN]
    lost = sum(LOST in trial.user_attrs for trial in shared.trials(TrialState.FAIL))
    counts = {
        "complete": len(complete),
        "pruned": len(shared.trials(TrialState.PRUNED)),
        "failed": len(shared.failed()),
        "killed and put back": lost,
    }
    told = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    title = f"{'Pareto front' if _several(shared) else 'Best trials'} of {shared.settings.study}"
    table = Table(title=f"{title} ({told or 'no trial yet'})")
    for heading in ("trial", *objectives):
        table.add_column(heading, justify="right", overflow="fold")
    table.add_column("settings")
    for trial in rows:
        settings = "  ".join(f"{name}={_short(value)}" for name, value in trial.params.items())
        table.add_row(str(trial.number), *(_short(value) for value in trial.values), Text(settings))
    return table


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _csv(trials: Sequence[FrozenTrial], objectives: Sequence[str], path: Path) -> Path:
    names = sorted({name for trial in trials for name in trial.params})
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["trial", "state", "seconds", *objectives, *names, "error"])
        for trial in trials:
            seconds = trial.duration.total_seconds() if trial.duration else ""
            values = trial.values if trial.state is TrialState.COMPLETE else [""] * len(objectives)
            attributes: Mapping[str, Any] = trial.user_attrs
            problem = attributes.get(ERROR) or attributes.get(LOST, "")
            settings = [trial.params.get(name, "") for name in names]
            writer.writerow([trial.number, trial.state.name.lower(), seconds, *values, *settings, problem])
    return path
