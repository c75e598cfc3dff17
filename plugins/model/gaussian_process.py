"""Model `gaussian_process`: a standard regressor, as a yardstick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import describe, register
from pgdl_lab.learning.model import Model

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.loss import Loss
    from pgdl_lab.surrogate.process_surrogate import ProcessSurrogate
    from pgdl_lab.surrogate.record import Record


@register("model", "gaussian_process")
@dataclass(frozen=True)
class GaussianProcess(Model):
    """scikit-learn's Gaussian process on the body's Laplace eigenfunctions and the pressure.

    Of the losses only the data count: nothing holds the clamp, and terms of physics are refused. Error bars are its
    standard deviation, scaled to errors at points that were held out.

    Attributes
    ----------
    points
        Number of training points that are used, drawn at random, as the cost grows with their cube.
    modes
        Number of eigenfunctions; bodies of fewer than 4 times as many points get a quarter of their points.
    """

    in_space: ClassVar[bool] = True
    several_inputs: ClassVar[bool] = True

    points: int = 1000
    modes: int = 32

    def __post_init__(self) -> None:
        from pgdl_lab.surrogate.process_surrogate import MOST_POINTS

        for name in ("points", "modes"):
            if getattr(self, name) < 1:
                raise InputError(f"model.{name} is {getattr(self, name)}; it must be at least 1.")
        if self.points > MOST_POINTS:
            raise InputError(f"model.points is {self.points}; {MOST_POINTS} are the most, as the cost is cubic.")

    def left_out(self, losses: Mapping[str, Loss]) -> dict[str, str]:
        from pgdl_lab.learning.linear import left_out

        return left_out("gaussian_process", losses, held=(), why="it is fitted to the data alone, clamped points too")

    def fit(self, training: Training) -> ProcessSurrogate:
        import warnings

        import numpy as np

        from pgdl_lab.learning.clock import Clock
        from pgdl_lab.learning.gaussian_process import fitted
        from pgdl_lab.learning.linear import tell_left_out
        from pgdl_lab.learning.threads import threads
        from pgdl_lab.surrogate.record import Record
        from pgdl_lab.surrogate.triangulation import Triangulation

        tell_left_out("gaussian_process", self.left_out(training.losses))
        scene, rng = training.scene, np.random.default_rng(training.seed)
        clock = Clock(training.trainer.max_seconds)
        with threads(training.trainer.threads), warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="sklearn")  # of a search that ends at a bound
            body = Triangulation.of(scene.domain)
            state = fitted(body, training.whole, self.modes, self.points, rng, clock)
        return self.restore(state, Record(training.whole.ranges(), dict(training.provenance), domain=scene.kept_domain))

    def restore(self, state: Mapping[str, NDArray[np.generic]], record: Record) -> ProcessSurrogate:
        from pgdl_lab.surrogate.process_surrogate import ProcessSurrogate

        return ProcessSurrogate(describe(self), record, state)
