"""The command line: Hydra composes the configuration, the chosen task does the work, errors become sentences."""

import importlib
import json
import logging
import os
import signal
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from pgdl_lab.core import streams
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.paths import CONF, PLUGINS
from pgdl_lab.running import sweep
from pgdl_lab.running.composing import store_choices
from pgdl_lab.running.experiment import Experiment, drop_unchosen, restore, resumed, save
from pgdl_lab.running.folders import RUN_ID, begin, discard, end, is_empty
from pgdl_lab.running.hydra_versions import BASE, TRUST
from pgdl_lab.running.messages import EXPECTED, sentence, typed
from pgdl_lab.running.trial import PRUNED, TICKET, TrialPruned, time_limit
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)
_tracebacks = logging.getLogger("pgdl_lab.failure")  # goes to run.log only


def main() -> None:
    """Run what the command line says; the exit code is 0 only if everything went well."""
    streams.last()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra hands its errors over; `sentence` words them
    logging.captureWarnings(True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # a cluster's stop: leave in order
    sys.path += [str(folder) for folder in PLUGINS if (folder / "hydra_plugins").is_dir()]
    store_choices()
    problem: str | None = None
    status = "KILLED"
    try:
        hydra.main(config_path=str(CONF), config_name="config", **BASE, **TRUST)(job)()
        status = "FINISHED"
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    except Exception as error:
        status = "FAILED"
        problem = sentence(error)
        if not isinstance(error, (*EXPECTED, OSError)):
            traceback.print_exc()
    finally:
        folder = sweep.take_folder()
        if folder is not None:
            problem = _end_sweep(folder, status) or problem
    if problem is not None:
        sys.exit(f"pgdl-lab: {problem}")


def job(config: DictConfig) -> Any:
    """Run the chosen task in the folder that Hydra made; a failure is told in `run.log` there."""
    settings = HydraConfig.get()
    folder = Path(settings.runtime.output_dir)
    sweep_folder = Path(settings.sweep.dir) if settings.mode == RunMode.MULTIRUN else None
    is_new = config.resume is None and config.get("run") is None
    if sweep_folder is not None:
        (folder / sweep.OVERRIDES).write_text(json.dumps(list(settings.overrides.task)), encoding="utf-8")
    try:
        if config.resume is not None:
            if sweep_folder is not None:
                raise InputError("resume continues one run: leave out -m, or resume the runs of a multirun one by one.")
            config = resumed(config, folder, settings.overrides.task)
        work = _work(config, folder, sweep_folder)
        with time_limit(folder):
            result = importlib.import_module(f"pgdl_lab.tasks.{config.task}").run(work)
        if config.get("run") is None:
            end(folder)
        return result
    except TrialPruned as stop:
        _log.info(str(stop))
        end(folder)
        return PRUNED
    except (KeyboardInterrupt, SystemExit):  # Lightning makes the latter of the former
        how = (
            f"{typed('resume', folder)} goes on with it" if config.get("run") is None else "type it again to begin anew"
        )
        print(f"\npgdl-lab: stopped; {how}", file=sys.stderr)
        raise
    except Exception as error:
        problem = sentence(error)
        _tracebacks.exception(problem)
        if sweep_folder is None and is_new and isinstance(error, InputError) and is_empty(folder):
            _discard(folder)
        if sweep_folder is None:  # Hydra would add a line of its own to an exception
            sys.exit(f"pgdl-lab: {problem}" + ("" if isinstance(error, EXPECTED) else f" (see {folder}/run.log)"))
        with suppress(OSError):  # a full disk, which `problem` tells of
            (folder / sweep.FAILURE).write_text(problem, encoding="utf-8")
        if not (folder / TICKET).is_file():  # the search marks its own
            _mark_failed(folder, sweep_folder, problem, settings.overrides.task)
        _log.error("Job %s failed: %s", folder.name, problem)
        raise


def _work(config: DictConfig, folder: Path, sweep_folder: Path | None) -> Job:
    """What the task is given: an experiment of its own, or with `run` an earlier one in the folder that it has."""
    if config.get("run") is None:
        drop_unchosen(config, HydraConfig.get().overrides.task)
        work = Job(Experiment.from_config(config), config, folder, sweep_folder)
        save(config, folder / "config.yaml")
        begin(folder)
        return work
    if sweep_folder is not None:
        raise InputError(f"task={config.task} works on one run: leave out -m.")
    stored = folder / "config.yaml"  # a multirun has none
    return Job(Experiment.from_config(restore(stored) if stored.is_file() else config), config, folder, None)


def _discard(folder: Path) -> None:
    """Remove what there is of a run that was refused."""
    if (folder / RUN_ID).is_file():
        from pgdl_lab.running.tracking import forget  # loads MLflow

        forget(folder)
    discard(folder)


def _mark_failed(folder: Path, sweep_folder: Path, problem: str, overrides: list[str]) -> None:
    from pgdl_lab.running.tracking import note_job  # loads MLflow

    note_job(folder, sweep_folder, "FAILED", {"error": problem}, {}, overrides)


def _end_sweep(folder: Path, status: str) -> str | None:
    """Compare the multirun's jobs and close its parent run; list the jobs that failed."""
    from pgdl_lab.running.multirun import compare
    from pgdl_lab.running.tracking import end_parent  # loads MLflow

    compared: list[Path] = []
    try:
        compared = compare(folder)
    except Exception as error:  # a full disk or a font: the jobs are done
        _log.warning("The jobs could not be set side by side: %s", error)
    end_parent(folder, status, compared)
    failed = sweep.failures(folder)
    if not failed:
        return None
    lines = "".join(f"\n  job {name}: {problem}" for name, problem in failed.items())
    return f"{len(failed)} of the multirun's jobs failed (more in {folder}/<job>/run.log):{lines}"
