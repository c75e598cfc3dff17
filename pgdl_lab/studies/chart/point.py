"""What a chart shows of one method, the Pareto front and the number of queries at which training has paid."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from math import ceil, inf
from typing import Any

from pgdl_lab.studies.chart.reference import Errors

TIE_TIME = 1.25  # two measurements of the same work on a machine that is not idle differ by as much
TIE_ERROR = 1.01


@dataclass(frozen=True)
class Point:
    """Errors and times of one method.

    Attributes
    ----------
    label, kind
        What it is; kinds are "finite elements", "surrogate" and "table".
    simulate_s
        Time of the simulation that gave its data; 0 if it needs none [s].
    train_s
        Time of its training; 0 if it has none [s].
    query_ms, tip_ms
        Median time for the whole field, and for the tip alone, at one pressure, on one thread [ms]. A finite-element
        model has to climb its load path for that.
    total
        Distance from the converged reference.
    discretisation
        Part of it that comes from the finite elements: all of a finite-element model's, that of the data of others.
    surrogate
        Distance from its data, at points and pressures that it was not given; None without data.
    failed
        Why there is nothing of all this.
    warnings
        What the simulation behind it warned of, in sentences.
    """

    label: str
    kind: str
    simulate_s: float = 0.0
    train_s: float = 0.0
    query_ms: float = 0.0
    tip_ms: float = 0.0
    total: Errors | None = None
    discretisation: Errors | None = None
    surrogate: Errors | None = None
    failed: str = ""
    warnings: list[str] = field(default_factory=list)

    @classmethod
    def restored(cls, stored: dict[str, Any]) -> "Point":
        """From what `asdict` made."""
        errors = {name: Errors(**stored[name]) for name in ("total", "discretisation", "surrogate") if stored.get(name)}
        return cls(**{**stored, **errors})

    def end_to_end_s(self, queries: int) -> float:
        """Time to simulate, to train and to answer `queries` [s]."""
        return self.simulate_s + self.train_s + 1e-3 * self.query_ms * queries

    def break_even(self, solver: "Point") -> float:
        """Number of queries from which this takes less time from end to end than `solver`; inf: never."""
        saved = 1e-3 * (solver.query_ms - self.query_ms)
        ahead = self.simulate_s + self.train_s - solver.simulate_s - solver.train_s
        if saved <= 0:
            return inf if ahead > 0 else 1
        return max(1, ceil(ahead / saved))

    def row(self) -> dict[str, Any]:
        """Flat record for a table: errors as `total_rms_mm` and so on."""
        flat = {key: value for key, value in asdict(self).items() if isinstance(value, str | float | int)}
        flat["warnings"] = " ".join(self.warnings)
        for part in ("total", "discretisation", "surrogate"):
            errors = getattr(self, part)
            flat |= {f"{part}_{name}": value for name, value in asdict(errors).items()} if errors else {}
        return flat


def pareto(points: Sequence[Point], seconds: Callable[[Point], float]) -> list[Point]:
    """Points that no other clearly beats, by rising time; errors are the total RMS.

    One that is clearly better in time or in error, and not clearly worse in the other, beats. Clear is more than the
    factor `TIE_TIME` or `TIE_ERROR`.
    """
    done = [(seconds(point), point.total.rms_mm, point) for point in points if point.total is not None]

    def beaten(time: float, error: float) -> bool:
        return any(
            (t * TIE_TIME < time and e <= error * TIE_ERROR) or (e * TIE_ERROR < error and t <= time * TIE_TIME)
            for t, e, _ in done
        )

    front = [each for each in done if not beaten(*each[:2])]
    return [point for *_, point in sorted(front, key=lambda each: each[:2])]
