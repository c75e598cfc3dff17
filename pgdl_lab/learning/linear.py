"""Models that are fitted by linear least squares."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgdl_lab.errors import InputError
from pgdl_lab.model import Model
from pgdl_lab.registry import describe

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from pgdl_lab.learning.data import Samples, Training
    from pgdl_lab.learning.nodal_surrogate import NodalSurrogate
    from pgdl_lab.learning.separable import SeparableRegression
    from pgdl_lab.surrogate import Record


@dataclass(frozen=True)
class LinearModel(Model):
    """Hat functions on the body times polynomials in the pressure, fitted by linear least squares; no network.

    The clamp is held exactly and of the losses only the data count: others are refused if they need derivatives.

    Attributes
    ----------
    degree
        Degree of the polynomials in the pressure.
    """

    degree: int = 7

    def __post_init__(self) -> None:
        if self.degree < 1:
            raise InputError(f"model.degree is {self.degree}; it must be at least 1.")

    @abstractmethod
    def learn(self, regression: SeparableRegression, training: Training) -> Mapping[str, Tensor]:
        """What the surrogate's state holds beside the body, see `NodalSurrogate`; it is compressed later."""

    def fit(self, training: Training) -> NodalSurrogate:
        from pgdl_lab.learning.pod import compressed
        from pgdl_lab.learning.threads import threads
        from pgdl_lab.surrogate import Record

        refuse_derivatives(training)
        with threads(training.trainer.threads):
            regression, body = regression_of(training, self.degree, training.whole)
            with closing(regression):
                state = compressed({**body, **self.learn(regression, training)})
        record = Record(training.whole.ranges(), dict(training.provenance), face=training.scene.face)
        return self.restore({name: tensor.numpy() for name, tensor in state.items()}, record)

    def restore(self, state: Mapping[str, NDArray[np.generic]], record: Record) -> NodalSurrogate:
        from pgdl_lab.learning.nodal_surrogate import NodalSurrogate

        return NodalSurrogate(describe(self), record, state)


def refuse_derivatives(training: Training) -> None:
    """Check that the data are all that a model is asked to fit.

    Raises
    ------
    InputError
        When a loss needs derivatives.
    """
    residuals = [name for name, loss in training.losses.items() if loss.order > 0]
    if residuals:
        raise InputError(
            f"This model is fitted to data alone and cannot take in loss {', '.join(residuals)}; "
            "leave it out or choose a neural model."
        )


def regression_of(
    training: Training, degree: int, samples: Samples | None = None
) -> tuple[SeparableRegression, dict[str, Tensor]]:
    """The regression of `degree` in the pressure, and what the state of a `NodalSurrogate` holds of the body.

    It is fitted to `samples`, by default those of the training that are not set aside.

    Its clock begins here: all fits together take the time budget of the training at most, but for the first two.
    """
    import numpy as np
    import torch

    from pgdl_lab.learning.clock import Clock
    from pgdl_lab.learning.separable import SeparableRegression
    from pgdl_lab.learning.triangulation import Triangulation

    scene, samples = training.scene, samples or training.samples
    range_kpa = np.array([0.0, samples.pressures_kpa.max()])
    body = Triangulation(scene.points_mm, scene.triangles)
    clock = Clock(training.trainer.max_seconds)
    return SeparableRegression(body, scene.clamp, samples, range_kpa, degree, clock), {
        "points_mm": torch.from_numpy(scene.points_mm),
        "triangles": torch.from_numpy(scene.triangles),
        "range_kpa": torch.from_numpy(range_kpa),
    }
