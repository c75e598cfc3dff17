"""The plugin kind `loss`: one term of what a training minimises."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.jet import Jet
    from pgdl_lab.learning.scene import Scene
    from pgdl_lab.mechanics.finger import Finger


@dataclass(frozen=True)
class Loss(ABC):
    """One term of the total loss, which is the sum of `weight` · `value` over all terms.

    A subclass sets `order`, the highest spatial derivative that it needs (0, 1 or 2): the jet of the field is computed
    once per step, to the highest order that any term needs, and shared by all terms at the training points. It sets
    `one_pressure`, if its own points have to be visited all at the same pressure, `unit`, for figures and tables, and
    `in_space`, if it holds for a whole body too and not for its side face alone, and clears `in_plane`, if it holds for
    a whole body alone.

    Attributes
    ----------
    weight
        Factor of this term in the total loss.
    """

    name: ClassVar[str]  # set by `register`
    order: ClassVar[int] = 0
    one_pressure: ClassVar[bool] = False
    unit: ClassVar[str] = ""
    in_space: ClassVar[bool] = False
    in_plane: ClassVar[bool] = True

    weight: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.weight < math.inf:
            raise InputError(f"The weight of a loss is {self.weight}; it must be zero or positive.")

    def check(self, finger: Finger | None) -> None:  # noqa: B027  # most terms suit every finger
        """Refuse a finger that this term cannot be written for, before anything is simulated.

        Raises
        ------
        InputError
            When its law or shape does not fit; the default fits all.
        """

    def own_points(self, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Points (M, 2) [mm] and prescribed displacements (M, 2) [mm] where this term is evaluated.

        None, the default, stands for the training points of the batch. Own points are visited at pressures that are
        drawn evenly from the lowest training pressure to the highest of interest, each at its own unless
        `one_pressure`.
        """
        return None

    @abstractmethod
    def value(self, jet: Jet, target_mm: Tensor, scene: Scene) -> Tensor:
        """The unweighted term, a scalar tensor.

        Parameters
        ----------
        jet
            The predicted displacement at n points and its derivatives up to `order` or beyond.
        target_mm
            (n, 2), the simulated displacement of training points, the prescribed one of own points [mm]; not a number
            where a term is visited at pressures without data.
        scene
            The body.
        """


@dataclass(frozen=True)
class PhysicsLoss(Loss):
    """A term that holds at any pressure and does not look at `target_mm`.

    Where a surrogate is to extrapolate there are no data, and what is known beside them is needed most: there the
    training points of a batch are visited at drawn pressures too, as own points are.

    Attributes
    ----------
    beyond
        Whether the term is visited above the trained pressures, up to the highest of interest. `physics_beyond.py` of
        the benchmarks measured what that does to the error there, by term: 6 % less to 7 % more at weights worth
        0.01 mm, as the defaults are or less; 4 % less to 39 % more at 0.1 mm. It does not pay by itself.
    """

    beyond: bool = True

    def refuse_sideways_gravity(self, finger: Finger | None) -> None:
        """Refuse a finger that gravity bends out of the plane whose balance of forces this term is about.

        Raises
        ------
        InputError
            When gravity has a part along y.
        """
        if finger is not None and not finger.planar:
            raise InputError(
                f"Loss {self.name} balances forces in the x–z plane, and finger.gravity_m_s2 is {finger.gravity_m_s2}, "
                "with a part along y that bends the finger out of it; set that to 0 or leave this loss out."
            )
