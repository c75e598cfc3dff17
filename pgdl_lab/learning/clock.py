"""How much of a time budget is spent."""

from time import monotonic as now


class Clock:
    """A time budget that is being spent since this was made.

    Parameters
    ----------
    limit_s
        The budget [s].
    spent_s
        What was spent of it before [s].
    """

    def __init__(self, limit_s: float, spent_s: float = 0.0) -> None:
        self.limit_s = limit_s
        self._since = now() - spent_s

    @property
    def seconds(self) -> float:
        """What is spent [s]."""
        return now() - self._since

    @property
    def left_s(self) -> float:
        """What is left [s], at least 0."""
        return max(self.limit_s - self.seconds, 0.0)
