"""What is asked of a choice: the settings of `conf/task/choose.yaml`."""

from dataclasses import dataclass, field

import numpy as np

from pgdl_lab.core.errors import InputError


@dataclass(frozen=True)
class ChooseSettings:
    """Tolerance, budgets, and the ladder that is climbed.

    Attributes
    ----------
    tolerance_mm
        Largest error of the displacement of any observed point at any pressure, against a converged solution [mm].
    budget_s
        Longest time to simulate and to train what is chosen [s]; None: any.
    budget_ms
        Longest time of a query of the whole field [ms]; None: a simulation will do.
    cheap
        Finite-element models that are tried before the solid, the cheapest first.
    solid
        The finite-element model that converges, and estimates its discretisation error.
    meshes
        Its longest edges, as multiples of `fem.edge_mm`, the coarsest first.
    estimated
        Edges from this multiple on are fine enough to be estimated by the mesh before them alone.
    models
        Surrogates in the order in which they are tried.
    more_points
        Multiples of `split.points` that are tried in turn.
    """

    tolerance_mm: float = 1.0
    budget_s: float | None = None
    budget_ms: float | None = None
    cheap: list[str] = field(default_factory=list)
    solid: str = "solid"
    meshes: list[float] = field(default_factory=lambda: [2.0, 1.0, 0.5])
    estimated: float = 1.0
    models: list[str] = field(default_factory=list)
    more_points: list[int] = field(default_factory=lambda: [1, 4])

    def __post_init__(self) -> None:
        for name, unit in (("tolerance_mm", "mm"), ("budget_s", "s"), ("budget_ms", "ms")):
            value = getattr(self, name)
            if value is None and name != "tolerance_mm":
                continue
            if isinstance(value, str) or not 0 < value < np.inf:
                raise InputError(f"{name} is {value}; it must be above 0, for example {name}=1 for 1 {unit}.")
        if not self.meshes or sorted(self.meshes, reverse=True) != list(self.meshes) or self.meshes[-1] <= 0:
            raise InputError(f"choose.meshes is {list(self.meshes)}; give falling multiples of fem.edge_mm above 0.")
        if self.budget_ms is not None and not self.models:
            raise InputError("choose.models names no surrogate, and budget_ms asks for one: name at least one.")
