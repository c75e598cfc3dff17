"""What the command line can do: one module per choice of `task=`, each with a function `run(job)`."""

from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from pgdl_lab.running.experiment import Experiment


@dataclass(frozen=True)
class Job:
    """What a task is given.

    Attributes
    ----------
    experiment
        What was chosen, checked.
    config
        All settings, those of the task (`conf/task/`) included.
    folder
        Where the run writes.
    sweep_folder
        Folder of the multirun that the job belongs to, or None.
    """

    experiment: Experiment
    config: DictConfig
    folder: Path
    sweep_folder: Path | None
