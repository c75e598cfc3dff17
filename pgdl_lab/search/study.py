"""A study shared by any number of processes: who runs which trial, and when enough of them are done."""

from __future__ import annotations

import secrets
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import optuna
from filelock import FileLock, Timeout
from hydra.utils import instantiate
from optuna.trial import FrozenTrial, TrialState

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.search.journal import KernelLock
from pgdl_lab.search.settings import DEFAULT_SAMPLER
from pgdl_lab.search.tally import LOST, RETRY_OF, Tally

if TYPE_CHECKING:
    from optuna.storages import BaseStorage

    from pgdl_lab.search.settings import SearchSettings
    from pgdl_lab.search.space import Space

SCHEMA, EXHAUSTED = "schema", "exhausted"  # attributes of a study
WORKER, ERROR = "worker", "error"  # attributes of a trial
_DIRECTION = {each.name.lower(): each for each in optuna.study.StudyDirection}


class _AskedStudy(optuna.Study):
    """Study outside `optimize`, whose samplers may still say that nothing is left to try."""

    def stop(self) -> None:
        self.set_user_attr(EXHAUSTED, True)


@dataclass(frozen=True)
class Claim:
    """A trial that this process runs.

    Attributes
    ----------
    trial
        Optuna's trial.
    overrides
        Its settings, as typed.
    """

    trial: optuna.Trial
    overrides: list[str]


class SharedStudy:
    """The study of a search, opened by one worker.

    A worker holds a lock file as long as it lives, and the kernel takes it back from one that is killed. So a running
    trial of a worker whose lock is free is lost for certain, whatever the time since it was last heard of.

    Parameters
    ----------
    folder
        Folder of the study, the same for all workers.
    settings
        Its settings.
    storage
        Where it is kept.
    space
        What is searched.
    config
        All other settings and their values, the same in every trial.

    Raises
    ------
    InputError
        If the study was begun with another search space, other objectives or settings.
    """

    def __init__(
        self, folder: Path, settings: SearchSettings, storage: BaseStorage, space: Space, config: Mapping[str, Any]
    ) -> None:
        self.folder, self.settings, self.space = folder, settings, space
        self.lock = KernelLock(folder / ".study.lock")
        self._workers = folder / ".workers"
        self._workers.mkdir(exist_ok=True)
        self.worker = secrets.token_hex(6)
        self._alive = FileLock(self._workers / self.worker)
        self._alive.acquire()
        self._new = True
        self._known = Tally()
        sampler = dict(settings.sampler or DEFAULT_SAMPLER)
        self._seed = sampler.get("seed")
        with making("sampler"):
            self._new_sampler = instantiate(sampler, _partial_=True)
            self._sampler(0)
        schema: dict[str, Any] = {
            "objective": settings.directions,
            "target": {name: list(target) for name, target in settings.targets.items()},
            "space": space.description(),
            "setting": dict(config),
        }
        with self.lock:
            optuna.create_study(
                study_name=settings.study,
                storage=storage,
                directions=[_DIRECTION[each] for each in settings.directions.values()],
                load_if_exists=True,
            )
            self.study = _AskedStudy(settings.study, storage)
            known = self.study.user_attrs.get(SCHEMA)
            if known is None:
                self.study.set_user_attr(SCHEMA, schema)
            else:
                _check_same(settings.study, known, schema)
            if settings.pruner is not None:
                with making("pruner"):
                    self.study.pruner = instantiate(settings.pruner)
            if settings.retry_failed:
                for trial in self.failed():
                    self._enqueue(trial, trial.params)

    def trials(self, *states: TrialState) -> list[FrozenTrial]:
        """Trials in these states, or all, by number."""
        return self.study.get_trials(deepcopy=False, states=states or None)

    def _tally(self) -> Tally:
        self._known.read(self.trials())
        return self._known

    def ended(self) -> list[FrozenTrial]:
        """Trials that count towards `n_trials`."""
        return list(self._tally().ended.values())

    def failed(self) -> list[FrozenTrial]:
        """Trials that failed and were not run again."""
        return list(self._tally().failed.values())

    @property
    def complete(self) -> bool:
        """Whether all trials are done, or nothing is left to try."""
        tally = self._tally()
        return self._exhausted(tally) or len(tally.ended) >= self.settings.n_trials

    def _exhausted(self, tally: Tally) -> bool:
        return not tally.count(TrialState.WAITING) and bool(self.study.user_attrs.get(EXHAUSTED, False))

    def claim(self, recover: Callable[[FrozenTrial], list[float] | None]) -> list[Claim]:
        """Trials for this worker to run next; none if others run all that are left.

        Trials of killed workers are looked for when a worker comes and when nothing else is left: with a thousand
        workers, to try their locks at every claim would take longer than the claims.

        Parameters
        ----------
        recover
            The values of a killed worker's trial, or None if the trial had not come to its end.

        Raises
        ------
        LabError
            If too many trials failed.
        """
        self.trials()  # what others have told by now is read before the lock is taken, and kept
        with self.lock:
            tally = self._tally()
            left = self._left(tally)
            if (self._new or not left) and self._take_up_lost(tally, recover):
                tally = self._tally()
                left = self._left(tally)
            self._new = False
            self._check_failures(tally)
            return [self._ask(tally.total + n) for n in range(min(left, self.settings.batch))]

    def _left(self, tally: Tally) -> int:
        """How many trials are neither done nor running."""
        left = max(self.settings.n_trials - len(tally.ended) - tally.count(TrialState.RUNNING), 0)
        return 0 if left and self._exhausted(tally) else left

    def _ask(self, number: int) -> Claim:
        with making("sampler"):
            self.study.sampler = self._sampler(number)
        trial = self.study.ask()
        overrides = self.space.suggest(trial)
        trial.set_user_attr(WORKER, self.worker)  # last: a trial without it was never begun
        return Claim(trial, overrides)

    def _sampler(self, number: int) -> Any:
        """A sampler for one trial: with one seed for all, workers and resumed studies would draw the same again."""
        if not isinstance(self._seed, int):
            return self._new_sampler()
        seed = np.random.SeedSequence([self._seed, number]).generate_state(1)
        return self._new_sampler(seed=int(seed[0]))

    def _take_up_lost(self, tally: Tally, recover: Callable[[FrozenTrial], list[float] | None]) -> bool:
        """Put trials of workers that are gone back into the queue, or keep their values if they had come to an end.

        Returns
        -------
        Whether there were any.
        """
        lost = [
            trial
            for trial in tally.open
            if trial.state is TrialState.RUNNING and not self._lives(trial.user_attrs.get(WORKER))
        ]
        for trial in lost:
            values = recover(trial) if WORKER in trial.user_attrs else None
            if values is not None:
                self.study.tell(trial.number, values)
                continue
            # What was drawn already is kept, also of a trial that was lost while its parameters were being drawn.
            if params := {**trial.system_attrs.get("fixed_params", {}), **trial.params}:
                self._enqueue(trial, params)
            self.study._storage.set_trial_user_attr(trial._trial_id, LOST, "its worker was killed")
            self.study.tell(trial.number, state=TrialState.FAIL)
        return bool(lost)

    def _enqueue(self, trial: FrozenTrial, params: Mapping[str, Any]) -> None:
        if all(other.user_attrs.get(RETRY_OF) != trial.number for other in self.trials()):
            self.study.enqueue_trial(dict(params), user_attrs={RETRY_OF: trial.number})

    def _lives(self, worker: str | None) -> bool:
        if worker is None or worker == self.worker:
            return worker is not None
        file = self._workers / worker
        try:
            with FileLock(file, timeout=0):
                pass
        except Timeout:
            return True
        file.unlink(missing_ok=True)
        return False

    def _check_failures(self, tally: Tally) -> None:
        settings, ended, failed = self.settings, tally.ended, tally.failed
        last = f"the last with: {failed[max(failed)].user_attrs.get(ERROR)}" if failed else ""
        remedy = f"mend that and add hydra.sweeper.retry_failed=true (runs/{settings.study}/<trial>/run.log says more)"
        if len(failed) == len(ended) >= settings.first_failures:
            raise LabError(f"The study stopped: all of its first {len(failed)} trials failed, {last} - {remedy}.")
        if len(failed) > settings.max_failure_rate * settings.n_trials:
            raise LabError(
                f"The study stopped: {len(failed)} of {len(ended)} trials failed, {last} - more than "
                f"hydra.sweeper.max_failure_rate={settings.max_failure_rate:g} of {settings.n_trials}; {remedy}."
            )

    def tell(self, claim: Claim, values: list[float] | None, error: str | None = None) -> None:
        """Note how a trial ended: with values, with an error, or pruned if there is neither."""
        if error is not None:
            claim.trial.set_user_attr(ERROR, error)
            self.study.tell(claim.trial, state=TrialState.FAIL)
        elif values is None:
            self.study.tell(claim.trial, state=TrialState.PRUNED)
        else:
            self.study.tell(claim.trial, values)

    def close(self) -> None:
        """Let other workers see that this one is gone."""
        self._alive.release()
        (self._workers / self.worker).unlink(missing_ok=True)


@contextmanager
def making(setting: str) -> Iterator[None]:
    """Tell what is wrong with a sampler or pruner, and leave out Optuna's warnings that an argument is experimental."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        try:
            yield
        except Exception as error:  # each class has errors of its own; Hydra puts the cause behind its own
            reason = str(error.__cause__ or error).splitlines()[-1]
            raise InputError(
                f"hydra.sweeper.{setting} cannot be made, give {{_target_: class, its arguments}}: {reason}"
            ) from error


def _check_same(study: str, known: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    for what, ours in now.items():
        theirs = known[what]
        for name in sorted({*theirs, *ours}):
            if theirs.get(name) != ours.get(name):
                raise InputError(
                    f"The study '{study}' was begun with another {what} {name}: {theirs.get(name, 'none')} there, "
                    f"{ours.get(name, 'none')} now; type hydra.sweeper.study=NAME for a new study."
                )
