"""The finger in CalculiX, a second code on the mesh of the solid."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.calculix_program import program, version
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger

if TYPE_CHECKING:
    from pgdl_lab.mechanics.calculix import Course
    from pgdl_lab.mechanics.finite_strain import Model


@register("fem", "calculix")
@dataclass(frozen=True)
class Calculix(Fem):
    """The program CalculiX on the model of `fem=solid fem.element=hex20`: element C3D20R, weight, then pressure.

    It must be installed (Debian package calculix-ccx). Under pressure its Newton iteration converges ever more slowly,
    as one does that lacks the stiffness of the follower load, and it fails where the solid still converges. Of a law in
    principal stretches (`ogden`) it has few digits at strains below 1e-3: it agrees with the solid under the weight and
    pressures of soft fingers, and fails on stiff ones, which barely deform.

    Attributes
    ----------
    edge_mm
        Longest element edge [mm]; up to 7 % more is let pass. Half of it halves each element.
    tolerance
        Largest last correction of an increment as a fraction of the increment [–]. CalculiX's own default leaves
        errors of some 0.1 % on `finger=pneunet_reference`; 1e-5 leaves a tenth of that, but takes many times as long
        and fails at a lower pressure.
    timeout_s
        Longest time that CalculiX may take [s].
    """

    edge_mm: float = 3.0
    tolerance: float = 0.01  # what CalculiX itself takes
    timeout_s: float = 3600.0

    def __post_init__(self) -> None:
        for name, unit in (("edge_mm", " mm"), ("tolerance", ""), ("timeout_s", " s")):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"fem.{name} is {getattr(self, name)}{unit}; it must be above 0.")

    def programs(self) -> Mapping[str, str]:
        try:
            return {"calculix": version()}
        except InputError:
            return {"calculix": "not installed"}

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        from pgdl_lab.mechanics.calculix import run
        from pgdl_lab.mechanics.finite_strain import Model

        self.refuse_further_loads(finger)
        program()  # before anything is computed
        began = time.perf_counter()
        face = finger.face(observation.points)
        model = Model(finger, self.edge_mm, "hex20")
        pressures_kpa = observation.pressures_kpa(finger.max_kpa)
        course = run(model, finger, pressures_kpa, self.tolerance, self.timeout_s)
        probe = model.probe(face)
        equilibria, found = course.pressures_kpa.tolist(), list(course.displacements)
        gives_way = model.gives_way_kpa(equilibria, found)
        lean, crossed = model.lean(equilibria, found, gives_way), model.crossed_kpa(equilibria, found)
        warnings, trouble = [], ""
        if lean is not None and lean.counts:
            warnings.append(lean.told(gives_way, len(equilibria), finger))
        if crossed:
            warnings.append(
                f"Surfaces pass through each other at {crossed[0]:.4g} kPa and more, as fem=calculix leaves contact "
                "out: choose fem=solid."
            )
        warnings.append(
            "The discretisation error of fem=calculix is not estimated; on a mesh of 3 mm its element is some 10 % "
            f"off: {finger.finer(self.edge_mm)} and compare, or choose fem=solid."
        )
        if course.trouble:
            trouble = (
                f"CalculiX found equilibria up to {course.reached_kpa:.4g} kPa, but not at "
                f"finger.max_kpa={finger.max_kpa:g} ({course.trouble}): {len(found) - 1} of {observation.snapshots} "
                "snapshots converged; lower the pressure or choose fem=solid."
            )
        return self.dataset(
            finger,
            face,
            course.pressures_kpa[1:],
            [probe(displacement) for displacement in found[1:]],
            self._provenance(model, course)
            | {
                "sideways_unstable_kpa": gives_way,
                "sideways_lean": None if lean is None else asdict(lean),
                "penetration_kpa": crossed,
                "seconds": time.perf_counter() - began,
            },
            body=Dataset.path(model.domain(face), course.pressures_kpa, course.displacements),
            warnings=warnings,
            trouble=trouble,
        )

    def _provenance(self, model: "Model", course: "Course") -> dict[str, Any]:
        # By the solid's own inner forces, at the displacement that CalculiX found.
        reaction, outer = model.reaction_and_load_n(course.displacements[-1], float(course.pressures_kpa[-1]))
        return {
            "mesh": {
                "elements": model.mesh.nelements,
                "nodes": len(model.discretisation.positions),
                "degrees_of_freedom": int(model.equilibrium.free.sum()),
            },
            "equilibria_kpa": course.pressures_kpa.tolist(),
            "reached_kpa": course.reached_kpa,
            "increments": course.increments,
            "newton_iterations": course.iterations,
            "cpu_seconds": course.cpu_seconds,
            "threads": course.threads,
            "reaction_n": reaction.tolist(),
            "load_n": outer.tolist(),
            "versions": dict(self.programs()),
        }
