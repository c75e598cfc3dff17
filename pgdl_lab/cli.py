"""The command line: Hydra composes the configuration, the chosen task does the work, errors become sentences."""

import importlib
import logging
import os
import pkgutil
import signal
import sys
import traceback
from pathlib import Path

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

import pgdl_lab.tasks
from pgdl_lab import registry, sweep
from pgdl_lab.errors import InputError
from pgdl_lab.experiment import Experiment, resumed, save, store_schema
from pgdl_lab.folders import link_latest
from pgdl_lab.messages import EXPECTED, sentence
from pgdl_lab.paths import CONF
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)
_tracebacks = logging.getLogger("pgdl_lab.failure")  # goes to run.log only


def main() -> None:
    """Run what the command line says; the exit code is 0 only if everything went well."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra hands its errors over; `sentence` words them
    logging.captureWarnings(True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # a cluster's stop: leave in order
    store_choices()
    problem: str | None = None
    status = "KILLED"
    try:
        hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)()
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


def store_choices() -> None:
    """Put all plugins, settings and tasks into Hydra's ConfigStore."""
    registry.discover()
    store_schema()
    for module in pkgutil.iter_modules(pgdl_lab.tasks.__path__):
        ConfigStore.instance().store(group="task", name=module.name, node={"task": module.name}, package="_global_")


def job(config: DictConfig) -> float | None:
    """Run the chosen task in the folder that Hydra made; a failure is told in `run.log` there."""
    settings = HydraConfig.get()
    folder = Path(settings.runtime.output_dir)
    sweep_folder = Path(settings.sweep.dir) if settings.mode == RunMode.MULTIRUN else None
    try:
        if config.resume is not None:
            if sweep_folder is not None:
                raise InputError("resume continues one run: leave out -m, or resume the runs of a multirun one by one.")
            config = resumed(config, folder, settings.overrides.task)
        work = Job(Experiment.from_config(config), config, folder, sweep_folder)
        save(config, folder / "config.yaml")
        link_latest(folder)
        result: float | None = importlib.import_module(f"pgdl_lab.tasks.{config.task}").run(work)
        return result
    except (KeyboardInterrupt, SystemExit):  # Lightning makes the latter of the former
        print(f"\npgdl-lab: stopped; resume={folder} goes on with it", file=sys.stderr)
        raise
    except Exception as error:
        problem = sentence(error)
        _tracebacks.exception(problem)
        if sweep_folder is None:  # Hydra would add a line of its own to an exception
            sys.exit(f"pgdl-lab: {problem}" + ("" if isinstance(error, EXPECTED) else f" (see {folder}/run.log)"))
        (folder / sweep.FAILURE).write_text(problem, encoding="utf-8")
        _log.error("Job %s failed: %s", folder.name, problem)
        raise


def _end_sweep(folder: Path, status: str) -> str | None:
    """Close the multirun's parent run; list the jobs that failed."""
    from pgdl_lab.tracking import end_parent  # loads MLflow

    end_parent(folder, status)
    failed = sweep.failures(folder)
    if not failed:
        return None
    lines = "".join(f"\n  job {name}: {problem}" for name, problem in failed.items())
    return f"{len(failed)} of the multirun's jobs failed (more in {folder}/<job>/run.log):{lines}"
