"""Three-dimensional finite-strain solid: the reference that everything else is measured against."""

import logging
import platform
import time
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import register
from pgdl_lab.mechanics.contact import REACH_MM
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger

if TYPE_CHECKING:
    from pgdl_lab.mechanics.finite_strain import Model
    from pgdl_lab.mechanics.loading import History

_log = logging.getLogger(__name__)

COARSE_PERCENT = 3.0
PREVENT = {"off": "use fem.contact=auto", "auto": "use fem.contact=on", "on": "refine the mesh"}
CONTACT_MODES = ("auto", "on", "off")


@register("fem", "solid")
@dataclass(frozen=True)
class Solid(Fem):
    """The finger, by symmetry half of it, nearly incompressible, quasi-static: weight first, then follower pressure.

    Attributes
    ----------
    edge_mm
        Longest element edge [mm]; up to 7 % more is let pass. Half of it halves each element.
    element
        On hexahedra `hex27_p1` (27 nodes, discontinuous linear pressure), `hex27_p0` (mean dilatation), `hex27` or
        `hex20` (displacement only); on tetrahedra `tet10_p0` (10 nodes, mean dilatation), `tet15_p1`
        (discontinuous linear pressure) or `tet10` (displacement only). `auto`: hex27_p1 or tet10_p0, whichever fits.
        With mean dilatation displacements are of second order and strains of first, one less than with linear pressure.
    contact
        Frictionless contact of the outer surfaces, of the walls in a chamber, and of half a finger with its mirror
        image: `auto` (from the step in which they first touch), `on` or `off`.
    contact_mm
        Distance below which surfaces push each other apart; they never come nearer than a part of it [mm].
    newton_mm
        An equilibrium is found when Newton's correction is below this [mm].
    interpolation_mm
        Largest error of snapshots that are interpolated between equilibria [mm].
    estimate_error
        Whether to estimate the discretisation error at the highest pressure, by what half the edges would change; takes
        about as long as the simulation, and some seven times its memory.
    """

    edge_mm: float = 3.0
    element: str = "auto"
    contact: str = "auto"
    contact_mm: float = REACH_MM
    newton_mm: float = 1e-6
    interpolation_mm: float = 1e-5
    estimate_error: bool = True

    def __post_init__(self) -> None:
        from pgdl_lab.mechanics.elements import AUTO, ELEMENTS

        for name in ("edge_mm", "contact_mm", "newton_mm", "interpolation_mm"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"fem.{name} is {getattr(self, name)} mm; it must be above 0.")
        if self.element not in (AUTO, *ELEMENTS):
            raise InputError(f"fem.element is '{self.element}'; choose one of {', '.join((AUTO, *ELEMENTS))}.")
        if self.contact not in CONTACT_MODES:
            raise InputError(f"fem.contact is '{self.contact}'; choose one of {', '.join(CONTACT_MODES)}.")

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        from pgdl_lab.mechanics.elements import ELEMENTS
        from pgdl_lab.mechanics.finite_strain import Model
        from pgdl_lab.mechanics.memory import require

        began = time.perf_counter()
        face = finger.face(observation.points)
        model = Model(finger, self.edge_mm, self.element, self.contact, self.contact_mm)
        if self.estimate_error:
            require(model.mesh, ELEMENTS[model.element], self.edge_mm, finger.mesh, refined=True)
        pressures = observation.pressures_kpa(finger.max_kpa)
        history = model.load(pressures, self.newton_mm, self.interpolation_mm)
        pressures, equilibria = history.reached(pressures), history.branch
        probe = model.probe(face)
        gives_way = history.sideways_unstable_kpa
        lean = model.lean(equilibria.parameters, equilibria.displacements, gives_way)
        provenance, warnings = self._provenance(model, history), history.warnings()
        if lean is not None and lean.counts:
            warnings.append(lean.told(gives_way, len(equilibria.parameters), finger))
        if crossed := provenance["contact"]["penetration_kpa"]:
            prevent = PREVENT["on" if model.contact.active else self.contact]
            warnings.append(f"Surfaces pass through each other at {crossed[0]:.4g} kPa and more: {prevent}.")
        return self.dataset(
            finger,
            face,
            pressures,
            [probe(history.at(kpa)) for kpa in pressures],
            provenance
            | {"sideways_lean": None if lean is None else asdict(lean), "seconds": time.perf_counter() - began},
            body=history.body(model.domain(face)),
            warnings=warnings,
            trouble=history.trouble(
                finger, len(pressures), observation.snapshots, "thicken the walls or refine the mesh"
            ),
        )

    def _discretisation_error(self, model: "Model", history: "History") -> dict[str, Any] | None:
        from pgdl_lab.mechanics.elements import AUTO, choose

        if not self.estimate_error:
            return None
        error = model.discretisation_error(history)
        if error is None:
            best = choose(AUTO, model.mesh)
            _log.warning(
                "The discretisation error could not be estimated, so it may be large: %s and compare%s.",
                model.finger.finer(self.edge_mm),
                "" if model.element == best else f", or choose fem.element={best}",
            )
        elif error.tip_percent > COARSE_PERCENT:
            _log.warning(
                "On a mesh with half the edges the tip would lie %.2g mm elsewhere at %.4g kPa, %.2g %% of its "
                "displacement: %s if that matters.",
                error.tip_mm,
                error.kpa,
                error.tip_percent,
                model.finger.finer(self.edge_mm),
            )
        return None if error is None else asdict(error)

    def _provenance(self, model: "Model", history: "History") -> dict[str, Any]:
        reaction, outer = model.reaction_and_load_n(history.branch.displacements[-1], history.reached_kpa)
        return {
            "element": model.element,
            "mesh": {
                "elements": model.mesh.nelements,
                "nodes": len(model.discretisation.positions),
                "degrees_of_freedom": int(model.equilibrium.free.sum()),
            },
            **history.provenance(),
            "discretisation_error": self._discretisation_error(model, history),
            "sideways_unstable_kpa": history.sideways_unstable_kpa,
            "reaction_n": reaction.tolist(),
            "load_n": outer.tolist(),
            "contact": model.contact_report(history),
            "linear_solver": model.solver.name,
            "versions": {"python": platform.python_version()}
            | {name: version(name) for name in ("numpy", "scipy", "scikit-fem")},
        }
