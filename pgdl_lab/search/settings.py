"""Settings of a search: the config group `hydra/sweeper=pgdl_optuna`."""

from dataclasses import dataclass, field
from typing import Any

from pgdl_lab.core.errors import InputError
from pgdl_lab.running.folders import check_study

DEFAULT_SAMPLER = {
    "_target_": "optuna.samplers.TPESampler",
    "seed": 0,
    "n_startup_trials": 8,
    "multivariate": True,
    "group": True,  # settings that exist under a condition only
    "constant_liar": True,  # trials that run elsewhere are not tried twice
}
MISFIT = "misfit"
"""Objective: the most that a metric lacks to its target, in units of its tolerance."""

SELECTION = "selection"
"""What the pruner sees: the error at points that are neither trained on nor tested on."""
SELECTION_MM2 = "selection_mm2"
"""The same in metrics.json, by component."""
NONE_LEFT = (
    "The search has no points to select by: split.points takes nearly all of the trained snapshots; ask for fewer "
    "or raise observation.points."
)


@dataclass(frozen=True)
class SearchSettings:
    """What is searched, how trials are chosen and when the search ends.

    Attributes
    ----------
    study
        Name of the study; its folder is `runs/<study>`, and whoever names it again goes on with it.
    n_trials
        Number of trials after which the study ends; pruned and failed ones count, killed ones do not.
    objectives
        Names in metrics.json that are minimised, or maximised where "maximize " stands before; a name may be a sum,
        such as "selection_mm2.x+selection_mm2.z", the error at points that are neither trained on nor tested on: what
        "mse_mm2" tells of the best of many trials would be too good if it were selected by.
    targets
        Metrics and [target, tolerance] of each, for the objective "misfit".
    params
        Search space: settings and their values in Hydra's grammar (`choice`, `range`, `interval`, with the tags `log`
        and `int`), or {space: ..., when: {other setting: [its values]}} for one that exists under a condition only.
    sampler, pruner
        Class (`_target_`) and arguments; None: `DEFAULT_SAMPLER`, no pruner. A sampler's `seed` is combined with the
        number of the trial.
    report
        What the pruner sees: `SELECTION`, the error at the same points, or "raw/<loss>" of the training.
    storage
        URL of a database: a journal in PostgreSQL, Optuna's tables in others; None: the file `study.journal` in the
        study's folder. Workers share that folder either way: its locks tell them which of them live.
    batch
        Trials that are handed to Hydra's launcher together.
    workers
        Processes that work on the study.
    threads
        CPU threads of each worker.
    trial_seconds
        Time limit of a trial [s].
    max_failure_rate
        Share of `n_trials` that may fail.
    first_failures
        The study stops when its first trials, so many, all fail.
    retry_failed
        Whether trials that failed earlier are run again.
    """

    study: str
    n_trials: int = 30
    objectives: list[str] = field(default_factory=lambda: [f"{SELECTION_MM2}.x+{SELECTION_MM2}.z"])
    targets: dict[str, list[float]] = field(default_factory=dict)
    params: dict[str, Any] = field(default_factory=dict)
    sampler: Any = None  # a mapping; OmegaConf puts none in the place of a typed None
    pruner: Any = None
    report: str = SELECTION
    storage: str | None = None
    batch: int = 1
    workers: int = 1
    threads: int = 1
    trial_seconds: float | None = None
    max_failure_rate: float = 0.3
    first_failures: int = 3
    retry_failed: bool = False

    def __post_init__(self) -> None:
        check_study(self.study)
        for name in ("n_trials", "batch", "workers", "threads", "first_failures"):
            if getattr(self, name) < 1:
                raise InputError(f"hydra.sweeper.{name} is {getattr(self, name)}; it must be at least 1.")
        if self.trial_seconds is not None and not self.trial_seconds > 0:
            raise InputError(f"hydra.sweeper.trial_seconds is {self.trial_seconds} s; it must be above 0.")
        if not 0 <= self.max_failure_rate <= 1:
            raise InputError(f"hydra.sweeper.max_failure_rate is {self.max_failure_rate}; it must lie within 0 and 1.")
        if not self.objectives:
            raise InputError("The search has no objective: set hydra.sweeper.objectives.")
        for name in self.directions:
            if " " in name:
                raise InputError(f"The objective '{name}' has a space; write NAME, NAME+NAME or 'maximize NAME'.")
        if MISFIT in self.directions and not self.targets:
            raise InputError(f"The objective {MISFIT} needs hydra.sweeper.targets: metrics and [target, tolerance].")
        for name, target in self.targets.items():
            if len(target) != 2 or not target[1] > 0:
                raise InputError(f"The target of {name} is {target}; give [target, tolerance], the latter above 0.")
        if self.pruner is not None and len(self.objectives) > 1:
            raise InputError(
                f"A pruner compares one value, but there are {len(self.objectives)} objectives "
                f"({', '.join(self.directions)}): set hydra.sweeper.pruner=null or keep one objective."
            )

    @property
    def directions(self) -> dict[str, str]:
        """Name of each objective and "minimize" or "maximize"."""
        return {name.removeprefix("maximize "): "maximize" if " " in name else "minimize" for name in self.objectives}
