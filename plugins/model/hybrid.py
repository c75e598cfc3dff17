"""Model `hybrid`: a cheap model of the mechanics, a network that corrects it, and the closed form of `pod`."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.inputs import PRESSURE
from pgdl_lab.core.registry import describe, names, register
from pgdl_lab.learning.neural import TrainedModel

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pgdl_lab.learning.data import Samples, Training
    from pgdl_lab.learning.guided import GuidedField
    from pgdl_lab.learning.loss import Loss
    from pgdl_lab.surrogate.record import Record
    from pgdl_lab.surrogate.surrogate import Surrogate

_log = logging.getLogger(__name__)

ENOUGH = 2000  # training points for the network, which has some hundred weights; the closed form takes all


@register("model", "hybrid")
@dataclass(frozen=True)
class Hybrid(TrainedModel):
    """A guide, corrected by a network under all losses, and a closed form, see model `pod`, for what both leave.

    The guide is a model of the finger's mechanics that costs a second. It knows weight, air and shape also where there
    are no data: between few points and beyond the trained pressures. The network moves and turns the sections of the
    finger further, see `GuidedField`; it is kept if it surely gains on the points that are set aside from it. Whether
    the guide helps at all is found out before, on strips of the body. Where it does not, or where there is none, the
    model is `pod` alone and says so. The result is stored at the nodes, as that of `pod`, and as fast.

    Attributes
    ----------
    guide
        The model of kind `fem` that guides; "none" for `pod` alone.
    correction_degree
        Degree of the network's part in the pressure.
    degree
        Degree of the guide's and of the closed form's part in the pressure.
    rounds
        How often the closed form's prior is learnt anew.
    """

    optimizer: ClassVar[str] = "lbfgs"
    several_inputs: ClassVar[bool] = True

    depth: int = 1
    width: int = 16
    activation: str = "tanh"
    dtype: str = "float64"
    patience: int | None = 50
    guide: str = "rod"
    correction_degree: int = 2
    degree: int = 10
    rounds: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in (("degree", 1), ("correction_degree", 0), ("rounds", 0)):
            if getattr(self, name) < least:
                raise InputError(f"model.{name} is {getattr(self, name)}; it must be at least {least}.")
        if self.correction_degree > self.degree:
            raise InputError(
                f"model.correction_degree is {self.correction_degree}; it must not be above model.degree={self.degree}."
            )
        if self.dtype != "float64":
            raise InputError("model.dtype of hybrid is float64: in float32 the corrections drown in rounding.")

    def left_out(self, losses: Mapping[str, Loss]) -> dict[str, str]:
        from pgdl_lab.learning.linear import require_data

        require_data("hybrid", losses)  # for its closed form
        # asked here, not when it is made: a robot that loads a surrogate has no finite elements
        known = [*names("fem"), "none"]
        if self.guide not in known:
            raise InputError(f"model.guide is '{self.guide}'; choose one of {', '.join(known)}.")
        return {}

    def fit(self, training: Training) -> Surrogate:
        from pgdl_lab.learning.clock import Clock
        from pgdl_lab.learning.linear import BOUNDARY, DATA
        from pgdl_lab.surrogate.record import Record

        self.left_out(training.losses)
        clock = Clock(training.trainer.max_seconds)
        reason = self._alone(training)
        if not reason:
            return super().fit(training)
        known = (DATA, BOUNDARY)  # fitted, and held exactly
        idle = [name for name, loss in training.losses.items() if name not in known and loss.weight > 0]
        also = f" Loss {', '.join(idle)} trains nothing then: leave it out or choose model=body." if idle else ""
        _log.log(logging.WARNING if idle else logging.INFO, "Model hybrid: pod alone answers, as %s.%s", reason, also)
        record = Record({}, dict(training.provenance), domain=training.scene.kept_domain)
        return replace(self, guide="none")._with_closed_form(None, training, record, clock.seconds)

    def _alone(self, training: Training) -> str:
        """Why the closed form answers alone; empty if it does not."""
        import numpy as np

        from pgdl_lab.learning.guide import gains
        from pgdl_lab.learning.threads import threads

        if self.guide == "none":
            return "model.guide is none"
        if training.samples.cases.names != [PRESSURE]:
            return "a guide knows no other input than the pressure"
        with threads(training.trainer.threads):
            try:
                nodal = self._guide(training)
            except LabError as problem:
                return f"fem={self.guide} cannot guide it ({str(problem).rstrip('.')})"
            rng = np.random.default_rng(training.seed)
            gain = gains(training.scene, training.whole, nodal, self.degree, rng)
        return "" if gain else f"fem={self.guide} as a guide would not lower its error"

    def _guide(self, training: Training) -> NDArray[np.float64]:
        from pgdl_lab.learning.guide import guide

        return guide(training.scene, self.guide, float(training.whole.pressures_kpa.max()), self.degree)

    def begin(self, training: Training) -> tuple[GuidedField, Samples]:
        import numpy as np
        import torch

        from pgdl_lab.learning.guided import MOTIONS, GuidedField
        from pgdl_lab.learning.layers import fully_connected

        scene, samples = training.scene, training.samples
        field = GuidedField(
            torch.from_numpy(scene.domain.points_mm),
            torch.from_numpy(scene.domain.cells),
            torch.from_numpy(self._guide(training)),
            torch.tensor([0.0, training.whole.pressures_kpa.max()], dtype=torch.double),
            fully_connected(1, MOTIONS * (self.correction_degree + 1), self.depth, self.width, self.activation),
        )
        few = np.random.default_rng(training.seed).permutation(len(samples))[:ENOUGH]
        field.scale_to(samples)
        return field, samples.at(np.sort(few))

    def finished(self, field: GuidedField, record: Record, training: Training) -> Surrogate:
        from pgdl_lab.learning.clock import Clock
        from pgdl_lab.learning.pod import network_gains
        from pgdl_lab.learning.threads import threads

        spent_s = record.history[-1]["seconds"] if record.history else 0.0
        clock, field = Clock(training.trainer.max_seconds, spent_s), field.cpu()
        with threads(training.trainer.threads):
            if field.corrects and not network_gains(training, self.degree, self.rounds, field, spent_s):
                _log.info("Model hybrid: the network is left out, as fem=%s alone guides better.", self.guide)
                field = field.without_network()
        return self._with_closed_form(field, training, record, clock.seconds)

    def _with_closed_form(
        self, field: GuidedField | None, training: Training, record: Record, spent_s: float
    ) -> Surrogate:
        """The surrogate of `field` and of the closed form for what it leaves, or of the closed form alone.

        The closed form has the time that is left after `spent_s` [s].
        """
        from pgdl_lab.learning.compression import compressed
        from pgdl_lab.learning.pod import closed_form
        from pgdl_lab.learning.threads import threads

        record = replace(record, ranges=training.whole.ranges())
        with threads(training.trainer.threads):
            state = compressed(closed_form(training, self.degree, self.rounds, field, spent_s))
        return self.restore({name: tensor.numpy() for name, tensor in state.items()}, record)

    def restore(self, state: Mapping[str, NDArray[np.generic]], record: Record) -> Surrogate:
        from pgdl_lab.surrogate.nodal_surrogate import NodalSurrogate

        return NodalSurrogate(describe(self), record, state)
