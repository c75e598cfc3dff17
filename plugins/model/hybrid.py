"""Model `hybrid`: the closed form of `pod`, and a small network for what it leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgdl_lab.errors import InputError
from pgdl_lab.learning.neural import TrainedModel
from pgdl_lab.registry import describe, register

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from pgdl_lab.learning.corrected import CorrectedField
    from pgdl_lab.learning.data import Samples, Training
    from pgdl_lab.loss import Loss
    from pgdl_lab.surrogate import Record, Surrogate

DRAWS = 48  # random draws that the error bars are found from


@register("model", "hybrid")
@dataclass(frozen=True)
class Hybrid(TrainedModel):
    """A closed-form field, see model `pod`, that a network corrects under all losses; see `CorrectedField`.

    The network learns from errors of the closed form at points it was fitted without. Whether it brings anything is
    judged on points that are set aside from both; if not, the closed form is kept and learns from these points too. The
    trained field is stored at the nodes, so that it is as fast as the closed form and has its error bars.

    Attributes
    ----------
    inputs
        Modes of the closed form that the network sees, the strongest; each has two components.
    degree
        Degree of the closed form in the pressure.
    correction_degree
        Degree of the corrections in the pressure.
    rounds
        How often the closed form's prior is learnt anew.
    folds
        Parts of the data that are predicted from the other ones.
    """

    depth: int = 2
    width: int = 32
    activation: str = "tanh"
    dtype: str = "float64"
    patience: int | None = 25
    inputs: int = 6
    degree: int = 10
    correction_degree: int = 3
    rounds: int = 4
    folds: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in (("degree", 1), ("rounds", 0), ("folds", 2)):
            if getattr(self, name) < least:
                raise InputError(f"model.{name} is {getattr(self, name)}; it must be at least {least}.")
        if self.degree >= DRAWS:
            raise InputError(f"model.degree is {self.degree}; it must be below {DRAWS}.")
        if not 1 <= self.inputs <= self.degree + 1:
            raise InputError(f"model.inputs is {self.inputs}; the closed form has 1 to {self.degree + 1} modes.")
        if not 0 <= self.correction_degree <= self.degree:
            raise InputError(
                f"model.correction_degree is {self.correction_degree}; it must lie between 0 and the closed form's "
                f"{self.degree}."
            )
        if self.dtype != "float64":
            raise InputError("model.dtype of hybrid is float64: in float32 the corrections drown in rounding.")

    def left_out(self, losses: Mapping[str, Loss]) -> dict[str, str]:
        from pgdl_lab.learning.linear import require_data

        require_data("hybrid", losses)  # for its closed form
        return {}

    def begin(self, training: Training) -> tuple[CorrectedField, Samples]:
        from contextlib import closing

        import numpy as np
        import torch
        from threadpoolctl import threadpool_limits

        from pgdl_lab.learning.corrected import cross_fitted
        from pgdl_lab.learning.linear import regression_of
        from pgdl_lab.learning.pod import decompose, learnt_prior

        rng = np.random.default_rng(training.seed)
        regression, body = regression_of(training, self.degree)
        with threadpool_limits(training.trainer.threads), closing(regression):
            prior = learnt_prior(regression, self.rounds, rng)
            learnt = decompose(regression, prior, DRAWS, rng)
            samples, size_mm = training.samples, 1.0
            if regression.allows(self.folds):  # else there is no time for the network either
                samples, size_mm = cross_fitted(regression, prior, learnt, self.folds, rng)
        return self._field({**body, **learnt}, torch.tensor(size_mm, dtype=torch.double)), samples

    def _field(self, closed_form: Mapping[str, Tensor], scale_mm: Tensor) -> CorrectedField:
        from pgdl_lab.learning.corrected import CorrectedField
        from pgdl_lab.learning.layers import fully_connected

        inputs, outputs = 2 * self.inputs, 2 * (self.correction_degree + 1)
        deep = fully_connected(inputs, outputs, self.depth, self.width, self.activation)
        return CorrectedField(closed_form, scale_mm, deep, inputs, self.correction_degree)

    def finished(self, field: CorrectedField, record: Record, training: Training) -> Surrogate:
        from contextlib import closing

        import numpy as np

        from pgdl_lab.learning.linear import regression_of
        from pgdl_lab.learning.pod import compressed, known

        state = field.nodal()
        if not field.corrects and len(training.held.pressures_kpa):
            rng = np.random.default_rng(training.seed)
            regression, _ = regression_of(training, self.degree, training.whole)
            with closing(regression):
                state |= known(regression.posterior(field.prior(), DRAWS, rng))
        return self.restore({name: tensor.numpy() for name, tensor in compressed(state).items()}, record)

    def restore(self, state: Mapping[str, NDArray[np.generic]], record: Record) -> Surrogate:
        from pgdl_lab.learning.nodal_surrogate import NodalSurrogate

        return NodalSurrogate(describe(self), record, state)
