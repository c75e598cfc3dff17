"""The loop of a search: take trials, have them run, note how they ended, until all are done."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn, JobStatus
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf
from optuna.trial import FrozenTrial
from threadpoolctl import threadpool_limits

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.running import tracking
from pgdl_lab.running.folders import BEST
from pgdl_lab.running.messages import sentence
from pgdl_lab.running.sweep import OVERRIDES
from pgdl_lab.running.trial import PRUNED, Ticket
from pgdl_lab.search import objectives
from pgdl_lab.search.report import report
from pgdl_lab.search.settings import SearchSettings
from pgdl_lab.search.space import Space, parse
from pgdl_lab.search.storage import open_storage
from pgdl_lab.search.study import Claim, SharedStudy

_log = logging.getLogger(__name__)

HELPER = "PGDL_LAB_HELPER"
"""Environment variable that tells a worker that another one started it."""
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
POLL_S = 1.0
REPORTED = "reported"  # attribute of a study: how many trials its last report was about


class Search:
    """One worker of a search.

    Parameters
    ----------
    settings
        What is searched and how.
    context, task, config
        What Hydra hands to a sweeper.
    """

    def __init__(self, settings: SearchSettings, context: HydraContext, task: TaskFunction, config: DictConfig) -> None:
        if HELPER in os.environ:  # or what fails now would be tried again by every helper
            settings = replace(settings, retry_failed=False)
        self.settings, self.context, self.config = settings, context, config
        self.folder = Path(config.hydra.sweep.dir)
        with _threads(settings.threads):
            self.launcher = Plugins.instance().instantiate_launcher(
                hydra_context=context, task_function=task, config=config
            )

    def run(self, typed: Sequence[str]) -> None:
        """Work on the study until all its trials are done.

        Raises
        ------
        InputError
            If the search space cannot be read, or the study was begun with another one.
        LabError
            If too many trials failed.
        """
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        space = parse(self.settings.params, typed)
        fixed = [f"{name}={value}" for name, value in space.fixed.items()]
        base = dict(_leaves(self._composed(fixed)))
        self._composed([*fixed, *_first(space)])
        searched = tuple(f"{parameter.name}." for parameter in space.parameters)
        same = {key: value for key, value in base.items() if not f"{key}.".startswith(searched)}
        storage = open_storage(self.settings.storage, self.folder)
        shared = SharedStudy(self.folder, self.settings, storage, space, same)
        status = "KILLED"
        try:
            tracking.open_parent(self.folder, {"study": self.settings.study, **shared.space.description()})
            with self._helpers(), _threads(self.settings.threads):
                self._work(shared)
            status = "FINISHED"
        except LabError:
            status = "FAILED"
            raise
        finally:
            try:
                with shared.lock:
                    self._report(shared)
            finally:
                shared.close()
                tracking.end_parent(self.folder, status)

    def _composed(self, overrides: list[str]) -> Any:
        config = self.context.config_loader.load_sweep_config(self.config, overrides)
        plain: Any = OmegaConf.to_container(config)
        del plain["hydra"]
        return plain

    def _work(self, shared: SharedStudy) -> None:
        begun = len(shared.ended())
        if begun:
            _log.info("Study %s: %d of %d trials are done", self.settings.study, begun, self.settings.n_trials)
        while True:
            claims = shared.claim(self._recover)
            if claims:
                self._run(shared, claims)
            elif shared.complete:
                return
            else:
                time.sleep(POLL_S)  # if a worker that runs one of the last trials is killed, that trial comes back

    def _run(self, shared: SharedStudy, claims: list[Claim]) -> None:
        for claim in claims:
            self._ticket(claim).write(self._trial_folder(claim.trial.number))
        jobs = [[*claim.overrides, f"hydra.sweep.subdir={claim.trial.number}"] for claim in claims]
        try:
            returned: Sequence[Any] = self.launcher.launch(jobs, initial_job_idx=claims[0].trial.number)
        except Exception as error:  # the configuration does not fit together, or a launcher lost its processes
            returned = [error] * len(claims)
        unusable: InputError | None = None
        for claim, result in zip(claims, returned, strict=True):
            try:
                self._tell(shared, claim, result)
            except InputError as error:
                unusable = error
        if unusable is not None:
            raise unusable

    def _tell(self, shared: SharedStudy, claim: Claim, result: JobReturn | Exception) -> None:
        number = claim.trial.number
        values: list[float] | None = None
        problem: str | None = None
        unusable: InputError | None = None
        if isinstance(result, Exception):
            problem = sentence(result)
        elif result.status is not JobStatus.COMPLETED:
            problem = sentence(result._return_value)
        elif result.return_value != PRUNED:
            try:
                values = self._values(number)
            except InputError as error:
                unusable, problem = error, str(error)
            except LabError as error:
                problem = str(error)
        self._note(number, claim.overrides, values, problem)
        shared.tell(claim, values, problem)  # last: a worker that is killed before leaves a trial to be taken up
        if unusable is not None:
            raise unusable

    def _note(self, number: int, overrides: list[str], values: list[float] | None, problem: str | None) -> None:
        """Tell the log and MLflow how a trial ended; as `SharedStudy.tell`."""
        state = "complete" if values else "failed" if problem else "pruned"
        found = dict(zip(self.settings.directions, values, strict=True)) if values else {}
        told = problem or ", ".join(f"{name} {value:.4g}" for name, value in found.items())
        _log.info("Trial %d %s%s", number, state, f": {told}" if told else "")
        tracking.note_job(
            self._trial_folder(number),
            self.folder,
            {"complete": "FINISHED", "failed": "FAILED", "pruned": "KILLED"}[state],
            {"trial": str(number), "trial_state": state, **({"error": problem} if problem else {})},
            found,
            overrides,
        )

    def _values(self, number: int) -> list[float]:
        return objectives.values(self._trial_folder(number), self.settings.directions, self.settings.targets)

    def _recover(self, trial: FrozenTrial) -> list[float] | None:
        """Values of a trial whose worker was killed after the end of the job; its MLflow run is closed in any case."""
        try:
            values = self._values(trial.number)
        except LabError:
            tracking.close_killed(self._trial_folder(trial.number))
            return None
        typed = json.loads((self._trial_folder(trial.number) / OVERRIDES).read_text(encoding="utf-8"))
        self._note(trial.number, typed, values, None)
        return values

    def _trial_folder(self, number: int) -> Path:
        return self.folder / str(number)

    def _ticket(self, claim: Claim) -> Ticket:
        settings, trial = self.settings, claim.trial
        return Ticket(
            study=settings.study,
            storage=settings.storage,
            number=trial.number,
            trial_id=trial._trial_id,
            pruner=settings.pruner,
            report=settings.report,
            trial_seconds=settings.trial_seconds,
        )

    def _report(self, shared: SharedStudy) -> None:
        """Write the report unless another worker has done so for the same trials."""
        ended = len(shared.ended())
        if shared.study.user_attrs.get(REPORTED) == ended and (BEST / self.settings.study).is_dir():
            _log.info(
                "Study %s: %d of %d trials in %s", self.settings.study, ended, self.settings.n_trials, self.folder
            )
            return
        written = report(shared)
        tracking.log_to_parent(self.folder, written)
        shared.study.set_user_attr(REPORTED, ended)

    @contextmanager
    def _helpers(self) -> Iterator[None]:
        """Other workers in processes of their own; what they print is in worker_<n>.log."""
        helpers: list[subprocess.Popen[bytes]] = []
        count = 0 if HELPER in os.environ else self.settings.workers - 1
        try:
            for number in range(1, count + 1):
                with (self.folder / f"worker_{number}.log").open("ab") as output:
                    command = [sys.executable, "-m", "pgdl_lab", *sys.argv[1:]]
                    environment = {**os.environ, HELPER: str(number)}
                    helpers.append(subprocess.Popen(command, env=environment, stdout=output, stderr=output))
            yield
        except BaseException:
            for helper in helpers:
                helper.terminate()
            raise
        finally:
            for helper in helpers:
                helper.wait()


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Limit the threads of libraries that are loaded, and by the environment of those that will be."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, str(count)))
    try:
        with threadpool_limits(count):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value


def _first(space: Space) -> list[str]:
    """Some settings of the space without conditions: a wrong name shows before any work."""

    def least(distribution: Any) -> Any:
        categorical = isinstance(distribution, optuna.distributions.CategoricalDistribution)
        return distribution.choices[0] if categorical else distribution.low

    fixed = optuna.trial.FixedTrial({each.name: least(each.distribution) for each in space.parameters})
    return space.suggest(fixed)


def _leaves(tree: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
