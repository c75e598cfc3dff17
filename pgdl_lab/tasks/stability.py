"""Task `stability`: the failure map of all methods, silent failures first."""

import csv
import json
import logging
from dataclasses import asdict
from typing import Any

from omegaconf import OmegaConf

from pgdl_lab import paths
from pgdl_lab.errors import InputError
from pgdl_lab.files import replacing
from pgdl_lab.stability.outcome import Trial, cells
from pgdl_lab.stability.page import draw, write_page
from pgdl_lab.stability.run import StabilitySettings, all_trials
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> list[Trial]:
    """Make every trial that was not made before, and write stability.md, stability.csv, trials.json and stability.png.

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
        given |= {"seeds": 1, "train_s": given["train_s"] / 5}
    trials: list[Trial] = []
    for trial in all_trials(StabilitySettings(**given), quick, paths.RUNS):
        trials.append(trial)
    with replacing(job.folder / "trials.json") as temporary:
        temporary.write_text(json.dumps([asdict(trial) for trial in trials], indent=1), encoding="utf-8")
    rows = [cell.record() for cell in cells(trials).values()]
    with replacing(job.folder / "stability.csv") as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    write_page(trials, job.folder / "stability.md")
    draw(trials, job.folder / "stability.png")
    silent = sum(trial.silent for trial in trials)
    good = sum(trial.mode == "ok" for trial in trials)
    _log.info("%d of %d trials succeeded; %d were silently wrong", good, len(trials), silent)
    _log.info("The failure map: %s", job.folder / "stability.md")
    return trials
