"""How the budget of a training is shared out among its optimisers: laid down once, whatever the clock does later."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Mapping
from statistics import median
from typing import Any

from pgdl_lab.learning.clock import Clock

_log = logging.getLogger(__name__)

MEASURED = 0.1  # share of its time after which an optimiser's speed is known
LEAST, MOST = 5, 1000  # steps that the speed is told from: at least, and the last so many
RESERVE = 0.05  # share of the time that is kept back for steps that take longer than the first


class Plan:
    """From which step to which each optimiser works.

    An optimiser gets an equal part of the epochs that are left when it begins. If they do not fit into an equal part of
    the time that is left, at the speed of its first steps (the median, so that one that stalls does not count), it gets
    as many steps as do. That is settled once. A clock that stalls afterwards may end the training early, when the time
    is over, but moves no learning rate: steps that are done are the same steps.

    A resumed training with the same budget goes on with the same plan. With another budget the end of the present
    optimiser's part is laid down anew, as if the budget had been so from the beginning of this part on. So under a
    constant learning rate 20 epochs and 20 more are the same as 40; one that falls along a cosine goes on where that of
    40 epochs stands after 20, which is higher than it just was.

    Parameters
    ----------
    stages
        Number of optimisers.
    epochs, steps_per_epoch
        The budget in epochs, and the length of one.
    clock
        The budget in time.

    Attributes
    ----------
    stage
        The optimiser at work.
    begun, end
        Its first step, and that after its last.
    """

    def __init__(self, stages: int, epochs: int, steps_per_epoch: int, clock: Clock) -> None:
        self._stages, self._epochs, self._per_epoch, self._clock = stages, epochs, steps_per_epoch, clock
        self.start(0, 0)

    def start(self, stage: int, step: int) -> None:
        """Lay down the part of the optimiser `stage` that begins with `step`."""
        parts = self._stages - stage
        left = self._epochs * self._per_epoch - step
        self.stage, self.begun = stage, step
        self.end = self._per_epoch * math.ceil((step + left / parts) / self._per_epoch)  # whole epochs
        self._settled = False
        self._began_s = self._clock.seconds
        self._until_s = self._began_s + self._clock.left_s / parts
        self._last_s: float | None = None
        self._steps_s: deque[float] = deque(maxlen=MOST)  # how long they took
        self._epochs_s: deque[float] = deque(maxlen=MOST)
        self._epoch_began_s: float | None = None

    @property
    def last(self) -> bool:
        """Whether the optimiser at work is the last."""
        return self.stage + 1 == self._stages

    def progress(self, step: int) -> float:
        """Share of the present optimiser's part that lies before `step`."""
        return min((step - self.begun) / (self.end - self.begun), 1.0) if self.end > self.begun else 1.0

    def progress_of_all(self, step: int) -> float:
        """Share of the whole budget that is spent, by steps or by time, whichever is further."""
        by_steps = (self.stage + self.progress(step)) / self._stages
        return min(max(by_steps, self._clock.seconds / self._clock.limit_s), 1.0)

    def begins(self, step: int, once_per_epoch: bool) -> None:
        """Take note of the time at which `step` begins, and settle the end when that tells enough.

        Parameters
        ----------
        step
            The step.
        once_per_epoch
            Whether the first step of an epoch does the work of all.
        """
        if self._settled:
            return
        time_s = self._clock.seconds
        if step % self._per_epoch:
            if self._last_s is not None:
                self._steps_s.append(time_s - self._last_s)
        else:
            if self._epoch_began_s is not None:
                self._epochs_s.append(time_s - self._epoch_began_s)
            self._epoch_began_s = time_s
        self._last_s = time_s
        seen = len(self._epochs_s) + (0 if once_per_epoch else len(self._steps_s))
        if time_s >= self._until_s:
            fitting = 0
        elif seen >= LEAST and time_s - self._began_s >= MEASURED * (self._until_s - self._began_s):
            by_epochs = once_per_epoch or len(self._epochs_s) >= LEAST  # these hold what is done at their ends, too
            step_s = median(self._epochs_s) / self._per_epoch if by_epochs else median(self._steps_s)
            fitting = int((1 - RESERVE) * (self._until_s - time_s) / step_s) if step_s else self.end
        else:
            return
        self._settled = True
        if step + fitting < self.end:
            self.end = step + fitting
            epochs = (self.end - self.begun) / self._per_epoch
            _log.info("There is time for %.4g epochs of this optimiser; its learning rate follows that.", epochs)

    def state(self) -> dict[str, Any]:
        """What a resumed training goes on from."""
        kept = {"stage": self.stage, "begun": self.begun, "end": self.end, "settled": self._settled}
        return {**kept, "budget": [self._epochs, self._clock.limit_s]}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`, with the end of that if the budget is the same."""
        self.start(state["stage"], state["begun"])
        if state["budget"] == [self._epochs, self._clock.limit_s]:
            self.end, self._settled = state["end"], state["settled"]
