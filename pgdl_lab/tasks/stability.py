"""Task `stability`: the failure map of all methods, silent failures first."""

import csv
import json
import logging
from dataclasses import asdict
from typing import Any

from omegaconf import OmegaConf

from pgdl_lab.core import paths
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.registry import settings_of
from pgdl_lab.studies.stability.figure import draw
from pgdl_lab.studies.stability.outcome import Trial, cells
from pgdl_lab.studies.stability.page import write_page
from pgdl_lab.studies.stability.run import StabilitySettings, all_trials
from pgdl_lab.studies.stability.verdict import BAR, SILENT, counts
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> list[Trial]:
    """Make every trial that was not made before, and write the map: a page, a figure, stability.csv and trials.json.

    Raises
    ------
    InputError
        When a setting is outside its limits.
    """
    quick = job.config.quick
    if not isinstance(quick, bool):
        raise InputError(f"quick is {quick!r}; it must be true or false.")
    given: Any = OmegaConf.to_container(job.config.stability)
    if quick:
        given |= {"seeds": 1}
    settings = settings_of(StabilitySettings, "stability", given)
    trials = list(all_trials(settings, quick, paths.RUNS))
    with replacing(job.folder / "trials.json") as temporary:
        temporary.write_text(json.dumps([asdict(trial) for trial in trials], indent=1), encoding="utf-8")
    rows = [
        {"part": group[0].part, "method": method, "axis": axis, **counts(group)}
        for (method, axis), group in cells(trials).items()
    ]
    with replacing(job.folder / "stability.csv") as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    write_page(trials, _head(settings, quick, trials), job.folder / "stability.md")
    draw(trials, job.folder / "figures" / "stability.png")
    found = counts(trials)
    _log.info(
        "Of %d trials %d were silently wrong, %d stated a bar that does not hold, %d warned of what is not there",
        len(trials), found[SILENT], found[BAR], found["with a false alarm"],
    )  # fmt: skip
    _log.info("The failure map: %s", job.folder / "stability.md")
    return trials


def _head(settings: StabilitySettings, quick: bool, trials: list[Trial]) -> list[str]:
    """How the trials were made."""
    spent = sum(trial.seconds for trial in trials)
    seeds = f"{settings.seeds} {'seeds' if settings.seeds > 1 else 'seed'}"
    return [
        f"`python -m pgdl_lab task=stability{' quick=true' if quick else ''}`: {len(trials)} trials of a short "
        f"finger (`stability.finger`); networks",
        f"of {settings.updates} updates with {seeds}. The methods took {spent / 60:.0f} min in all, without the truths "
        "that they are measured against.",
    ]
