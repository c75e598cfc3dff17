"""Task `choose`: the least model that meets a tolerance in this scene, and an experiment file that runs it."""

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from pgdl_lab.core import paths
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe, settings_of
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.search.best import write_experiment
from pgdl_lab.studies.choosing.choice import Choice
from pgdl_lab.studies.choosing.climb import Climb, check_scene
from pgdl_lab.studies.choosing.settings import ChooseSettings
from pgdl_lab.studies.choosing.surrogates import add_surrogate
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)

OWN = ("quick", "tolerance_mm", "budget_s", "budget_ms", "choose")
QUICK = Observation(snapshots=20, points=800)
QUICK_SHARE = 0.05  # of the points that a surrogate is trained on


def run(job: Job) -> Choice:
    """Choose, and write choice.json, surrogate.pt if there is one, and the file for `experiment=choose/…`.

    Raises
    ------
    InputError
        When a setting is outside its limits or the finger cannot be meshed anew.
    SimulationStopped
        When the finger cannot bear the highest pressure.
    """
    settings, experiment = choose_settings(job), job.experiment
    experiment.observation.require_face("task=choose")
    check_scene(experiment)
    if job.config.quick:
        split = replace(experiment.split, points=int(QUICK_SHARE * QUICK.snapshots * QUICK.points))
        experiment = replace(experiment, observation=QUICK, split=split)
        settings = replace(settings, meshes=settings.meshes[:2])
    choice = choose(experiment, settings, paths.RUNS / "snapshots")
    if choice.surrogate is not None:
        choice.surrogate.save(job.folder / "surrogate.pt")
    with replacing(job.folder / "choice.json") as temporary:
        temporary.write_text(json.dumps(choice.record(), indent=1), encoding="utf-8")
    name = f"{describe(experiment.finger)['name']}_{settings.tolerance_mm:g}mm"
    path = paths.BEST / "experiment" / "choose" / f"{name}.yaml"
    _write(job, experiment, choice, settings, path)
    verdict = "within" if choice.met else "NOT within"
    _log.info(
        "%s %g mm: expected %.2g mm after %.0f s of trials", verdict, settings.tolerance_mm, choice.error_mm,
        choice.spent_s,
    )  # fmt: skip
    _log.info("It runs as: python -m pgdl_lab experiment=choose/%s", name)
    return choice


def choose(experiment: Experiment, settings: ChooseSettings, folder: Path) -> Choice:
    """The least model for a scene; simulations are kept in `folder`."""
    choice = Climb(experiment, settings, folder).run()
    return add_surrogate(choice, experiment, settings, _log.info)


def choose_settings(job: Job) -> ChooseSettings:
    """What is asked for, checked; raises InputError."""
    config = job.config
    if not isinstance(config.quick, bool):
        raise InputError(f"quick is {config.quick!r}; it must be true or false.")
    ladder: Any = OmegaConf.to_container(config.choose)
    asked = {name: config[name] for name in ("tolerance_mm", "budget_s", "budget_ms")}
    return replace(settings_of(ChooseSettings, "choose", ladder), **asked)


def _write(job: Job, experiment: Experiment, choice: Choice, settings: ChooseSettings, path: Path) -> None:
    """Turn this run's own configuration into that of what was chosen."""
    config: Any = OmegaConf.to_container(OmegaConf.load(job.folder / "config.yaml"))
    for name in OWN:
        config.pop(name, None)
    config["task"] = "train" if choice.model else "simulate"
    config["finger"], config["fem"] = describe(choice.finger), describe(choice.fem)
    config["observation"] = vars(experiment.observation).copy()
    config["split"] = describe(choice.split or experiment.split)
    if choice.model:
        config["model"] = describe(choice.model)
    chosen = job.folder / "chosen"
    chosen.mkdir()
    OmegaConf.save(OmegaConf.create(config), chosen / "config.yaml")
    met = "meets" if choice.met else "does NOT meet"
    write_experiment(chosen, path, f"{met} {settings.tolerance_mm:g} mm; expected {choice.error_mm:.2g} mm")
