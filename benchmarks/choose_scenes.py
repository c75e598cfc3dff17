"""Whether `task=choose` keeps its promise: scenes it was not tuned on, each against a converged reference.

    python benchmarks/choose_scenes.py                       # all of them: half an hour
    python benchmarks/choose_scenes.py --scene three_chambers --tolerance 0.1
    python benchmarks/choose_scenes.py --only-found          # the table of what there is

The three fingers at tolerances of 1, 0.1 and 0.01 mm, and altered fingers. References are extrapolated from two meshes
(`pgdl_lab.studies.chart.reference`), the finer one no coarser than what was chosen; errors are the largest of any
observed point at five pressures. A promise is kept when the error is within the tolerance, or within it but for what
the reference itself may err by (then it says so); a refusal is no promise. Brute force is what the climb looked at and
the finer meshes besides; trainings that the climb did not need are not counted against it.
Each scene is stored under runs/choose_scenes as soon as it is done, and not repeated.
"""

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from benchmarks import common
from benchmarks.scenes import COARSE, simulated
from pgdl_lab.core import paths, sources
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe, plugin
from pgdl_lab.running.composing import experiment
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.chart.reference import Reference, find_reference
from pgdl_lab.studies.choosing.choice import Choice
from pgdl_lab.studies.choosing.climb import largest
from pgdl_lab.studies.choosing.settings import ChooseSettings
from pgdl_lab.tasks.choose import choose

SNAPSHOTS = paths.RUNS / "snapshots"
REFERENCE = {"name": "solid", "edge_mm": 3.0, "newton_mm": 1e-4, "interpolation_mm": 1e-3, "estimate_error": False}
OBSERVATION = Observation(snapshots=20, points=4439)
BUDGET_MS = 1.0  # so that a surrogate is needed


@dataclass(frozen=True)
class Scene:
    """A finger, the tolerances to try, edges of the coarser mesh of its reference [mm], and what is observed."""

    typed: tuple[str, ...]
    tolerances_mm: tuple[float, ...]
    reference_mm: float = 3.0
    observation: Observation = OBSERVATION


SCENES = {
    "pneunet": Scene(("finger=pneunet",), (1.0, 0.1, 0.01)),
    "joints": Scene(("finger=joints",), (1.0, 0.1, 0.01)),
    "bellows": Scene(("finger=bellows",), (1.0, 0.1, 0.01)),
    "three_chambers": Scene(("finger=pneunet", "finger.chambers=3"), (1.0, 0.1, 0.01)),
    "one_joint": Scene(("finger=joints", "finger.joints=1", "finger.chambers=2"), (1.0, 0.1, 0.01)),
    "thin_walls": Scene(
        ("finger=pneunet_reference", "finger.chambers=3", "finger.wall_mm=2.0", "finger.max_kpa=20"), (1.0, 0.1)
    ),
}


QUICK = Scene(("finger=pneunet", "finger.chambers=2", *COARSE), (1.0,), 6.0, Observation(snapshots=20, points=400))


def main() -> None:
    """Run what is missing and print the table."""
    arguments = common.parser(__doc__)
    arguments.add_argument("--scene", action="append", choices=list(SCENES))
    arguments.add_argument("--tolerance", action="append", type=float, help="of the scene's own tolerances, these only")
    arguments.add_argument("--only-found", action="store_true", help="the table of what was run before")
    given = common.parsed(arguments)
    store, _ = common.folders("choose_scenes", given.quick)
    scenes = {"two_chambers": QUICK} if given.quick else {name: SCENES[name] for name in given.scene or SCENES}
    rows: list[tuple[str, float, dict[str, Any]]] = []
    for name, scene in scenes.items():
        for tolerance in scene.tolerances_mm:
            if given.tolerance and tolerance not in given.tolerance:
                continue
            found = result(store, name, scene, tolerance, given.only_found)
            if found is not None:
                rows.append((name, tolerance, found))
    show(rows)


def result(store: Path, name: str, scene: Scene, tolerance_mm: float, only_found: bool) -> dict[str, Any] | None:
    """What one scene shows, from the store or run now."""
    ladder = (paths.CONF / "task" / "choose.yaml").read_text()
    known = common.digest([scene.typed, scene.reference_mm, REFERENCE, ladder, sources.digest([choose])])
    path, never = store / f"{name}-{tolerance_mm:g}-{known}.json", -math.inf if only_found else math.inf
    stored = common.kept(path, lambda: run(scene, tolerance_mm), never)
    return stored and {**stored, "uncertainty_mm": reference(scene, case_of(scene)).uncertainty.largest_mm}


def run(scene: Scene, tolerance_mm: float) -> dict[str, Any]:
    """Choose, then judge."""
    case = case_of(scene)
    ladder: Any = OmegaConf.to_container(OmegaConf.load(paths.CONF / "task" / "choose.yaml"))
    settings = ChooseSettings(tolerance_mm, None, BUDGET_MS, **ladder["choose"])
    began = time.perf_counter()
    choice = choose(case, settings, SNAPSHOTS)
    waited = time.perf_counter() - began
    return {
        **choice.record(),
        "error_mm": error(scene, case, choice),
        "brute_force_s": brute_force_s(scene, case, choice),
        "waited_s": waited,
    }


def case_of(scene: Scene) -> Experiment:
    """Finger, observation and split of a scene."""
    seen = scene.observation
    case = replace(experiment(list(scene.typed)), observation=seen)
    return replace(case, split=replace(case.split, points=seen.snapshots * seen.points // 20))


def reference(scene: Scene, case: Experiment) -> Reference:
    """What errors are measured against."""
    judged = Observation(5, scene.observation.points)
    return find_reference(case.finger, {**REFERENCE, "edge_mm": scene.reference_mm}, judged, SNAPSHOTS)


def error(scene: Scene, case: Experiment, choice: Choice) -> float:
    """Largest error of what was chosen [mm]."""
    assert choice.snapshots is not None
    truth = reference(scene, case)
    which = truth.among(choice.snapshots.pressures_kpa)
    shown = choice.snapshots.displacements[which]
    if choice.surrogate is not None:
        shown = choice.surrogate.predict(choice.snapshots.domain.points_mm, choice.snapshots.pressures_kpa[which])
    return largest(shown - truth.displacements)


def brute_force_s(scene: Scene, case: Experiment, choice: Choice) -> float:
    """Time of what the climb looked at and of the meshes that it did not [s]."""
    times = [choice.spent_s]  # of the rungs and models that the climb looked at as well
    fine: Any = plugin("fem", "solid")(**{k: v for k, v in REFERENCE.items() if k != "name"})
    for edge in (scene.reference_mm, scene.reference_mm / 2):
        at = replace(fine, edge_mm=edge)
        if getattr(choice.fem, "edge_mm", None) != edge or describe(choice.fem)["name"] != "solid":
            snapshots = simulated(replace(case, fem=at, observation=Observation(5, scene.observation.points)))
            times.append(snapshots.provenance["seconds"])
    return float(np.sum(times))


def verdict(tolerance_mm: float, found: dict[str, Any]) -> str:
    """Kept, broken, or refused."""
    if not found["met"]:
        return "refused"
    over = found["error_mm"] - tolerance_mm
    if over <= 0:
        return "kept"
    return "kept, as far as the reference can tell" if over <= found["uncertainty_mm"] else "BROKEN"


def show(rows: list[tuple[str, float, dict[str, Any]]]) -> None:
    """The table and the hit rate."""
    headings = ("scene", "mm", "chosen", "promised", "error", "reference ±", "verdict", "time s", "brute force s")
    table = common.table("Promises of task=choose", headings)
    number = "{:.2g}".format
    for name, tolerance, found in rows:
        fem, model = found["fem"], found["model"]
        chosen = f"{fem['name']} {fem.get('edge_mm', 0):g} mm" + (f", {model['name']}" if model else "")
        numbers = (
            number(found["expected_error_mm"]["all"]),
            number(found["error_mm"]),
            number(found["uncertainty_mm"]),
        )
        times = (f"{found['spent_s']:.0f}", f"{found['brute_force_s']:.0f}")
        table.add_row(name, f"{tolerance:g}", chosen, *numbers, verdict(tolerance, found), *times)
    common.show(table)
    verdicts = [verdict(tolerance, found) for _, tolerance, found in rows]
    promised = [each for each in verdicts if each != "refused"]
    kept = sum(each.startswith("kept") for each in promised)
    spent, brute = (sum(found[key] for *_, found in rows) for key in ("spent_s", "brute_force_s"))
    print(f"{kept} of {len(promised)} promises kept, {len(verdicts) - len(promised)} refusals; ", end="")
    print(f"{spent:.0f} s against {brute:.0f} s by brute force")


if __name__ == "__main__":
    main()
