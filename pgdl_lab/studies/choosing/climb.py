"""Climb from the cheapest finite-element model until its a-posteriori estimate meets the tolerance.

The coarse solid is the only rung that is always computed: it tells the gaps, what the law of the material does, and by
its distance from the cheap rungs what these err by. Estimates are doubled, since they have been seen to be up to a
third too low (benchmarks/discretisation.py).
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.registry import describe, plugin
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.memory import TooLarge
from pgdl_lab.running.cache import simulate
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.choosing.choice import Choice
from pgdl_lab.studies.choosing.settings import ChooseSettings

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)

SAFETY = 2.0
ORDER = 2  # of convergence, by which a mesh is judged from the one before it
HOPED_ORDER = 3  # only what not even this reaches is given up before it is computed
SLOWER = 8.0  # times as long takes a mesh with half the edges at least
NEGLIGIBLE = 0.05  # of the tolerance: what changes less may be left out
FOR_SURROGATE = 0.3  # of the tolerance, kept free where one is needed
LEAST_CHEAP = 0.01  # of the displacement: models without the solid's third dimension have not been seen to err by less


@dataclass
class Climb:
    """One climb.

    Parameters
    ----------
    experiment
        The scene.
    settings
        What is asked for.
    folder
        Where simulations are kept.
    say
        Told every decision.
    """

    experiment: Experiment
    settings: ChooseSettings
    folder: Path
    say: Callable[[str], None] = _log.info

    def run(self) -> Choice:
        """The least finite-element model that meets the tolerance, or the best with `met` false.

        Raises
        ------
        LabError
            When the finger cannot be simulated.
        """
        self.choice = Choice(self.experiment.finger, self._solid(self.settings.meshes[0]))
        cheap = self._cheap_rungs()
        self._weigh(cheap)
        coarse = self._coarse()
        self._contact(coarse)
        if not self._accept_cheap(cheap, coarse):
            self._material(coarse)
            self._meshes(coarse)
        self._accuracy()
        return self.choice

    @property
    def allowed_mm(self) -> float:
        """What the finite elements may err by [mm]."""
        share = 1 - (FOR_SURROGATE if self.settings.budget_ms is not None else 0)
        return share * self.settings.tolerance_mm - self.choice.dropped_mm

    def _solid(self, factor: float, **changes: Any) -> Fem:
        given = self.experiment.fem
        if describe(given)["name"] != self.settings.solid:
            given = plugin("fem", self.settings.solid)()
        solid: Any = given
        # A hundredth of the tolerance leaves nothing to notice, and needs fewer equilibria.
        interpolation = float(np.clip(self.settings.tolerance_mm / 100, solid.interpolation_mm, 1e-2))
        fields = {"edge_mm": factor * solid.edge_mm, "interpolation_mm": interpolation, "estimate_error": True}
        return replace(solid, **{**fields, **changes})

    def _simulate(self, finger: Finger, fem: Fem) -> Dataset:
        snapshots, _, _ = simulate(finger, fem, self.experiment.observation, self.folder)
        self.choice.spent_s += snapshots.provenance["seconds"]
        return snapshots

    def _explain(self, reason: str) -> None:
        self.choice.reasons.append(reason)
        self.say(reason)

    def _cheap_rungs(self) -> dict[str, Dataset]:
        found = {}
        for name in self.settings.cheap:
            try:
                found[name] = self._simulate(self.choice.finger, plugin("fem", name)())
            except LabError as error:
                self._explain(f"fem={name} does not fit: {error}")
        return found

    def _weigh(self, cheap: dict[str, Dataset]) -> None:
        """Leave gravity out if it does nothing."""
        finger = self.choice.finger
        if not np.any(finger.body_force_n_mm3) or not cheap:
            return
        name, heavy = next(iter(cheap.items()))
        light = replace(finger, gravity_m_s2=[0.0, 0.0])
        effect = largest(self._simulate(light, plugin("fem", name)()).displacements - heavy.displacements)
        if effect > NEGLIGIBLE * self.settings.tolerance_mm:
            self._explain(f"gravity: kept, by fem={name} it moves the finger by {effect:.2g} mm")
            return
        self._explain(f"gravity: left out, by fem={name} it moves the finger by {effect:.2g} mm")
        self.choice.finger = light
        self.choice.dropped_mm += effect

    def _coarse(self) -> Dataset:
        fem = self._solid(self.settings.meshes[0])
        snapshots = self._simulate(self.choice.finger, fem)
        self._hold(fem, snapshots, SAFETY * estimate_mm(snapshots))
        return snapshots

    def _hold(self, fem: Fem, snapshots: Dataset, expected_mm: float) -> None:
        """Take a rung for the best so far."""
        self.choice.fem, self.choice.snapshots, self.choice.expected_mm = fem, snapshots, expected_mm

    def _contact(self, coarse: Dataset) -> None:
        report, fem = coarse.provenance["contact"], self.choice.fem
        gap, reach = report["smallest_gap_mm"], getattr(fem, "contact_mm", 0.0) + self.choice.expected_mm
        if report["acted"]:
            self._explain("contact: surfaces touch, so it is watched and acts")
        elif gap is not None and gap <= reach:
            self._explain(f"contact: gaps close to {gap:.2g} mm, which the error may hide, so it is watched")
        else:
            known = "surfaces never come near each other" if gap is None else f"gaps stay above {gap:.2g} mm"
            self._explain(f"contact: {known}: none")
            self._plain = {"contact": "off"}
            return
        self._plain = {}

    def _accept_cheap(self, cheap: dict[str, Dataset], coarse: Dataset) -> bool:
        for name, snapshots in cheap.items():
            moved = largest(coarse.displacements)
            apart = max(largest(snapshots.displacements - coarse.displacements), LEAST_CHEAP * moved)
            expected = apart + self.choice.expected_mm
            if expected <= self.allowed_mm and not coarse.provenance["contact"]["acted"]:
                self._explain(f"dimension: fem={name} is within {expected:.2g} mm, estimated by the coarse solid")
                self._hold(plugin("fem", name)(), snapshots, expected)
                self.choice.met = True
                return True
            self._explain(f"dimension: not fem={name}, {apart:.2g} mm from the coarse solid")
        return False

    def _material(self, coarse: Dataset) -> None:
        """Take neo-Hooke's law for another if that changes nothing."""
        finger, law = self.choice.finger, self.choice.finger.material
        simple = Yeoh(poisson=law.poisson, c1_mpa=law.shear_modulus_mpa / 2, c2_mpa=0.0)
        if simple == law or self.choice.expected_mm > 8 * self.allowed_mm:
            return  # nothing simpler, or too far from the tolerance to be worth a simulation
        other = replace(finger, material=simple)
        fem = self._solid(self.settings.meshes[0], estimate_error=False, **self._plain)
        try:
            effect = largest(self._simulate(other, fem).displacements - coarse.displacements)
        except LabError:
            self._explain(f"material: {describe(law)['name']}, neo-Hooke's law does not reach the highest pressure")
            return
        if effect > NEGLIGIBLE * self.settings.tolerance_mm:
            self._explain(f"material: {describe(law)['name']}, neo-Hooke's law would move points by {effect:.2g} mm")
            return
        self._explain(f"material: neo-Hooke, {describe(law)['name']} would move points by {effect:.2g} mm only")
        self.choice.finger = other
        self.choice.dropped_mm += effect

    def _meshes(self, before: Dataset) -> None:
        """Refine until the estimate is within what is allowed."""
        meshes, choice = self.settings.meshes, self.choice
        seconds, last = before.provenance["seconds"], meshes[-1]
        for number, factor in enumerate(meshes):
            if number:
                best = choice.expected_mm * (last / meshes[number - 1]) ** HOPED_ORDER
                if best > self.allowed_mm:
                    self._give_up(f"the finest mesh would leave {best:.2g} mm or more")
                    return
                took = seconds * SLOWER ** np.log2(meshes[number - 1] / factor)
                if self.settings.budget_s is not None and choice.spent_s + took > self.settings.budget_s:
                    self._give_up(f"a finer mesh would take {took:.0f} s more")
                    return
                fem = self._solid(factor, estimate_error=factor >= self.settings.estimated, **self._plain)
                try:
                    after = self._simulate(choice.finger, fem)
                except TooLarge as error:
                    self._give_up(str(error))
                    return
                seconds = after.provenance["seconds"]
                steps = meshes[number - 1] / factor
                expected = largest(after.displacements - before.displacements) / (steps**ORDER - 1)
                if factor >= self.settings.estimated:
                    expected = max(expected, estimate_mm(after))
                self._hold(fem, after, SAFETY * expected)
                before = after
            edge = getattr(choice.fem, "edge_mm", float("nan"))
            if choice.expected_mm <= self.allowed_mm:
                choice.met = True
                self._explain(f"mesh: edges of {edge:g} mm, within {choice.expected_mm:.2g} mm")
                return
            self._explain(f"mesh: not {edge:g} mm, which may err by {choice.expected_mm:.2g} mm")
        self._give_up("no finer mesh is on the ladder")

    def _give_up(self, reason: str) -> None:
        wanted, found = self.settings.tolerance_mm, self.choice.error_mm
        self._explain(f"NOT MET: {wanted:g} mm is out of reach ({reason}); the best found may err by {found:.2g} mm")

    def _accuracy(self) -> None:
        snapshots = self.choice.snapshots
        assert snapshots is not None
        equilibria = snapshots.provenance.get("equilibria_kpa", [])
        error = snapshots.provenance.get("interpolation_error_mm", 0.0)
        self.choice.expected_mm += error
        self._explain(f"load path: {len(equilibria)} equilibria, {error:.1g} mm between them")
        if self.settings.budget_s is not None and snapshots.provenance["seconds"] > self.settings.budget_s:
            self.choice.met = False
            self._explain(f"NOT MET: the simulation takes {snapshots.provenance['seconds']:.0f} s")


def estimate_mm(snapshots: Dataset) -> float:
    """Estimated largest discretisation error [mm]; inf if it is unknown."""
    error = snapshots.provenance.get("discretisation_error")
    return float(error["largest_mm"]) if error else float("inf")


def largest(difference: Array) -> float:
    """Largest length in (P, N, 2) [mm]."""
    return float(np.linalg.norm(difference, axis=-1).max())


def check_scene(experiment: Experiment) -> None:
    """Refuse a scene whose body cannot be meshed anew; raises InputError."""
    if experiment.finger.files():
        raise InputError(
            f"finger={describe(experiment.finger)['name']} is meshed already, so no mesh can be chosen for it; use "
            "task=chart to compare what is trained on it."
        )
