"""How the trials of a study stand."""

from collections.abc import Sequence

from optuna.trial import FrozenTrial, TrialState

RETRY_OF, LOST = "retry_of", "lost"
"""Attributes of a trial: the number of the one that it repeats; why it does not count."""


class Tally:
    """The trials of a study by how they stand, kept up with what is new in each reading.

    To go through all of thousands of trials at every claim would take longer than the claim.

    Attributes
    ----------
    ended, failed
        Trials that ended, neither lost nor run again since, and those of them that failed, by number.
    open
        Trials that wait or run.
    total
        Number of all trials.
    """

    def __init__(self) -> None:
        self.ended: dict[int, FrozenTrial] = {}
        self.failed: dict[int, FrozenTrial] = {}
        self.open: list[FrozenTrial] = []
        self.total = 0
        self._repeated: set[int] = set()

    def read(self, trials: Sequence[FrozenTrial]) -> None:
        """Take note of how the trials, all of the study by number, stand now."""
        news = [trials[trial.number] for trial in self.open] + list(trials[self.total :])
        self.total = len(trials)
        self.open = [trial for trial in news if not trial.state.is_finished()]
        self._repeated.update(trial.user_attrs[RETRY_OF] for trial in news if RETRY_OF in trial.user_attrs)
        for trial in news:
            if trial.state.is_finished() and LOST not in trial.user_attrs:
                self.ended[trial.number] = trial
                if trial.state is TrialState.FAIL:
                    self.failed[trial.number] = trial
        for number in self._repeated & self.ended.keys():
            del self.ended[number]
            self.failed.pop(number, None)

    def count(self, state: TrialState) -> int:
        """How many trials wait, or how many run."""
        return sum(trial.state is state for trial in self.open)
