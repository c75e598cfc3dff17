"""Model `body`: a network on coordinates that know the body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import register
from pgdl_lab.learning.neural import NeuralModel

if TYPE_CHECKING:
    from torch import Tensor

    from pgdl_lab.learning.data import Training
    from pgdl_lab.learning.modal import ModalField
    from pgdl_lab.surrogate.basis import Basis


@register("model", "body")
@dataclass(frozen=True)
class Body(NeuralModel):
    """A network of the body's Laplace eigenfunctions, polynomial in the inputs; see `ModalField`.

    Attributes
    ----------
    modes
        Number of eigenfunctions; bodies of fewer than 4 times as many points get a quarter of their points.
    degree
        Degree of the polynomials in the pressure; in several inputs together at most that.
    """

    several_inputs: ClassVar[bool] = True

    depth: int = 3
    modes: int = 256
    degree: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("modes", "degree"):
            if getattr(self, name) < 1:
                raise InputError(f"model.{name} is {getattr(self, name)}; it must be at least 1.")

    def new_field(self, training: Training) -> ModalField:
        import torch

        from pgdl_lab.learning.polynomials import basis_of
        from pgdl_lab.surrogate.triangulation import Triangulation

        scene = training.scene
        count = min(self.modes, len(scene.domain.points_mm) // 4)
        modes, eigenvalues = Triangulation(scene.domain.points_mm, scene.domain.cells).modes(count)
        field = self._field(
            torch.from_numpy(scene.domain.points_mm),
            torch.from_numpy(scene.domain.cells),
            torch.from_numpy(modes),
            torch.from_numpy(eigenvalues),
            basis_of(training.samples.cases, self.degree),
        )
        field.start_from(training.samples)
        return field

    def stored_field(self, state: Mapping[str, Tensor]) -> ModalField:
        from pgdl_lab.surrogate.basis import Basis

        basis = Basis.restored({name: each.numpy() for name, each in state.items()}, len(state["linear.weight"]) // 2)
        points_mm, triangles, modes, values = (
            state[name] for name in ("points_mm", "triangles", "modes", "eigenvalues")
        )
        return self._field(points_mm, triangles, modes, values, basis)

    def _field(self, points_mm: Tensor, triangles: Tensor, modes: Tensor, values: Tensor, basis: Basis) -> ModalField:
        from pgdl_lab.learning.layers import DTYPES, fully_connected
        from pgdl_lab.learning.modal import ModalField

        deep = fully_connected(modes.shape[1], 2 * len(basis.degrees), self.depth, self.width, self.activation)
        dtype = DTYPES[self.dtype]
        return ModalField(points_mm, triangles, modes, values, basis, deep, dtype)
