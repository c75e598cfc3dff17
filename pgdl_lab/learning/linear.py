"""Models that are fitted by linear least squares."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Collection, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import describe
from pgdl_lab.learning.model import Model

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from pgdl_lab.core.domain import Domain
    from pgdl_lab.learning.data import Samples, Training
    from pgdl_lab.learning.loss import Loss
    from pgdl_lab.learning.separable import SeparableRegression
    from pgdl_lab.surrogate.nodal_surrogate import NodalSurrogate
    from pgdl_lab.surrogate.record import Record

_log = logging.getLogger(__name__)

IN_SPACE = 5  # degree in a whole body: 2e-5 mm RMS from the simulated pneunet, and 69,000 unknowns
DATA, BOUNDARY = "data", "boundary"  # the terms that a closed form knows


@dataclass(frozen=True)
class LinearModel(Model):
    """Hat functions on the body times polynomials in the inputs, fitted by linear least squares; no network.

    The clamp is held exactly. Of the losses only the data count; terms of physics are refused.

    Attributes
    ----------
    degree
        Degree of the polynomials in the pressure; in several inputs together at most that, see `basis_of`. null: 7 on
        the side face, 5 in a whole body, where each degree more costs much time.
    """

    in_space: ClassVar[bool] = True
    several_inputs: ClassVar[bool] = True
    on_face: ClassVar[int] = 7

    degree: int | None = None

    def __post_init__(self) -> None:
        if self.degree is not None and self.degree < 1:
            raise InputError(f"model.degree is {self.degree}; it must be at least 1.")

    def left_out(self, losses: Mapping[str, Loss]) -> dict[str, str]:
        return left_out(describe(self)["name"], losses, held=(BOUNDARY,), why="")

    def degree_on(self, domain: Domain) -> int:
        """The degree that is fitted on a domain."""
        return self.degree or (IN_SPACE if domain.is_body else self.on_face)

    @abstractmethod
    def learn(self, regression: SeparableRegression, training: Training) -> Mapping[str, Tensor]:
        """What the surrogate's state holds beside the body, see `NodalSurrogate`; it is compressed later."""

    def fit(self, training: Training) -> NodalSurrogate:
        from pgdl_lab.learning.compression import compressed
        from pgdl_lab.learning.threads import threads
        from pgdl_lab.surrogate.record import Record

        self.left_out(training.losses)
        with threads(training.trainer.threads):
            regression, body = regression_of(training, self.degree_on(training.scene.domain), training.whole)
            with closing(regression):
                state = compressed({**body, **self.learn(regression, training)})
        record = Record(training.whole.ranges(), dict(training.provenance), domain=training.scene.kept_domain)
        return self.restore({name: tensor.numpy() for name, tensor in state.items()}, record)

    def restore(self, state: Mapping[str, NDArray[np.generic]], record: Record) -> NodalSurrogate:
        from pgdl_lab.surrogate.nodal_surrogate import NodalSurrogate

        return NodalSurrogate(describe(self), record, state)


def require_data(name: str, losses: Mapping[str, Loss]) -> None:
    """Check that there are data for the model `name` to be fitted to.

    Raises
    ------
    InputError
        When the loss holds none, or counts them with weight 0.
    """
    if not losses.get(DATA) or not losses[DATA].weight:
        raise InputError(
            f"model={name} is fitted to the data, and loss=[{','.join(losses)}] does not count them: add {DATA} with a "
            f"weight above 0 to the losses, or choose a network such as model={network_for(losses)}."
        )


def network_for(losses: Mapping[str, Loss]) -> str:
    """A network that takes these terms."""
    return "body" if all(loss.in_plane for loss in losses.values()) else "mlp"


def left_out(name: str, losses: Mapping[str, Loss], held: Collection[str], why: str) -> dict[str, str]:
    """What the model `name` leaves out, being fitted to the data alone in closed form, and why.

    Parameters
    ----------
    name, losses
        The model and the terms.
    held
        Terms that it satisfies exactly, so that nothing is left out.
    why
        What happens to a `BOUNDARY` that is not among these.

    Raises
    ------
    InputError
        When there are no data, or a term of physics counts.
    """
    require_data(name, losses)
    counted = [key for key, loss in losses.items() if loss.weight and key not in {DATA, *held}]
    refused = [key for key in counted if key != BOUNDARY]
    if refused:
        raise InputError(
            f"model={name} is fitted to data alone and cannot take in loss {', '.join(refused)}; leave it out, give it "
            f"the weight 0 to see its value, or choose a network such as model={network_for(losses)}."
        )
    return dict.fromkeys(counted, why)


def tell_left_out(name: str, terms: Mapping[str, str]) -> None:
    """Tell what a model leaves out, and why."""
    for term, why in terms.items():
        _log.warning("model=%s leaves out loss %s: %s.", name, term, why)


def regression_of(
    training: Training,
    degree: int,
    samples: Samples,
    rough: NDArray[np.float64] | None = None,
    spent_s: float = 0.0,
) -> tuple[SeparableRegression, dict[str, Tensor]]:
    """The regression of `degree` in the inputs on `samples`, and what a `NodalSurrogate` holds of the body.

    A field `rough` (N, …) tells where kinks are to be expected, see `SeparableRegression`. Its clock begins here, with
    what is `spent_s` already: all fits together take the time budget of the training at most, but for the first two.

    Raises
    ------
    InputError
        When there are fewer samples than a polynomial of that degree has coefficients, and no field guides it.
    """
    import torch

    from pgdl_lab.learning.clock import Clock
    from pgdl_lab.learning.polynomials import basis_of
    from pgdl_lab.learning.separable import SeparableRegression
    from pgdl_lab.surrogate.triangulation import Triangulation

    scene, count = training.scene, len(samples)
    if rough is None and count <= degree:
        lower = f", or set model.degree={count - 1}" if count > 1 else ""
        raise InputError(
            f"{count} training points do not determine a polynomial of degree {degree} in the pressure, which has "
            f"{degree + 1} coefficients at each place: train on {degree + 1} points at least{lower}."
        )
    basis = basis_of(samples.cases, degree)
    body = Triangulation.of(scene.domain)
    clock = Clock(training.trainer.max_seconds, spent_s)
    return SeparableRegression(body, scene.domain.clamp, samples, basis, rough, clock), {
        "points_mm": torch.from_numpy(scene.domain.points_mm),
        "triangles": torch.from_numpy(body.simplices),
        **{name: torch.from_numpy(array) for name, array in basis.state().items()},
    }
