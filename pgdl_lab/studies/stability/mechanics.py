"""Finite-element models under stress: load steps, incompressibility, thin walls, gravity, pressure, meshes, contact.

Each trial is compared with the truth of its scene, see `truth`: its displacement with that of the whole body on a finer
mesh, what it says of its mesh with the true error at the tip, and its elements with each other, where
there are any, to see whether they overlap. Where the truth has no equilibrium, a model that finds one is wrong.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import Any

import numpy as np

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import field_names, names, plugin
from pgdl_lab.mechanics import calculix_deck, loading, path
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.studies.stability import truth
from pgdl_lab.studies.stability.outcome import CONTACT, GOOD, UNSTABLE, WIDE, Bar, Heard, Result
from pgdl_lab.studies.stability.overlap import overlaps
from pgdl_lab.studies.stability.truth import Truth, truth_of

OBSERVATION = Observation(snapshots=4, points=300)
EDGE_MM = 6.0
MAX_KPA = 20.0
WRONG_WITHOUT_EQUILIBRIUM = 1.0  # relative error of a result where there is none to compare with
END = 1e-6  # of the length: nodes so near to the largest x are the end of the finger
SOFT = Yeoh(c1_mpa=0.004, c2_mpa=0.0)


@dataclass(frozen=True)
class Stress:
    """A scene of an axis.

    Attributes
    ----------
    axis, level
        The stress and how hard it is.
    finger
        What is simulated.
    fields
        Changes of the model's fields, as far as it has them.
    meddle
        What is done to the load path meanwhile.
    even
        The finger that tells the truth, where that is not `finger`.
    needs
        The field of models that the stress reaches; the others would only repeat a trial.
    edge_mm
        Those of the finer mesh of the truth [mm].
    contact
        Contact in it: "auto", or "on" where it is what the stress is about.
    """

    axis: str
    level: str
    finger: Finger
    fields: dict[str, Any]
    meddle: Callable[[], AbstractContextManager[None]] = nullcontext
    even: Finger | None = None
    needs: str = ""
    edge_mm: float = truth.EDGE_MM
    contact: str = "auto"


def stresses(finger: Finger, quick: bool) -> Iterator[Stress]:
    """All scenes made of `finger`, a short one; the quick ones are the last but one of each axis."""

    def levels(*all_levels: Any) -> tuple[Any, ...]:
        return all_levels[-2:][:1] if quick else all_levels

    for steps in levels(100, 10, 3, 1):
        yield Stress("load steps", f"{steps}", finger, {}, partial(_steps, steps))
    for poisson in levels(0.49, 0.499, 0.4999):
        stiff = replace(finger, material=replace(finger.material, poisson=poisson))
        yield Stress("Poisson's ratio", f"{poisson}", stiff, {})
    for wall in levels(3.0, 2.0, 1.5, 1.0, 0.6):
        yield Stress("wall thickness", f"{wall:g} mm", _changed(finger, wall_mm=wall, max_kpa=1.5 * MAX_KPA), {})
    for gravity in levels(
        [0.0, -9.81], [0.0, 9.81], [9.81, 0.0], [-9.81, 0.0], [0.0, 9.81, 0.0], [0.0, 0.0], [0.0, -98.1]
    ):
        yield Stress(
            "gravity", f"{', '.join(f'{part:g}' for part in gravity)} m/s²", replace(finger, gravity_m_s2=gravity), {}
        )
    for factor in levels(1.0, 1.5, 2.0, 3.0, 5.0):
        yield Stress("pressure", f"{factor * MAX_KPA:g} kPa", replace(finger, max_kpa=factor * MAX_KPA), {})
    for edge in levels(4.0, 6.0, 8.0, 12.0):
        yield Stress("coarse mesh", f"{edge:g} mm", finger, {"edge_mm": edge})
    for share in levels(0.1, 0.2, 0.3):
        # on the mesh of the reference: on the coarser one no node is free to move
        yield Stress("distorted mesh", f"{share:.0%}", distorted(finger, share), {"edge_mm": EDGE_MM / 2}, even=finger)
    touching = _changed(finger, wall_mm=1.5, gap_mm=0.3, max_kpa=1.25 * MAX_KPA)
    for mode in levels("on", "as it is set", "off"):
        given = {} if mode == "as it is set" else {"contact": mode}
        yield Stress("contact sets in", mode, touching, given, needs=next(iter(given), ""), contact="on")
    for high, mode in levels((4.0, ""), (1.2, ""), (1.2, "off")):
        level, given = f"{high:g} mm high{mode and ', contact off'}", {"contact": mode} if mode else {}
        scene, needs = _low(finger, high), next(iter(given), "")
        yield Stress("ceiling on floor", level, scene, given, needs=needs, edge_mm=2 * truth.EDGE_MM, contact="on")
    for chambers, gravity in levels((2, 30.0), (2, 100.0), (2, 400.0), (10, 30.0)):
        level, edge = f"{chambers} chambers, {gravity:g} m/s²", truth.EDGE_MM if chambers == 2 else 2 * truth.EDGE_MM
        yield Stress("leans sideways", level, _narrow(finger, chambers, gravity), {}, edge_mm=edge)
    for told, stretch, size in levels(
        ("as it is", 1.0, 0.0), ("the last equilibrium", 0.0, 0.0), ("too far by half", 1.5, 0.0),
        ("0.03 mm off", 1.0, 0.03), ("0.3 mm off", 1.0, 0.3), ("1 mm off", 1.0, 1.0),
    ):  # fmt: skip
        yield Stress("poor predictor", told, finger, {}, partial(_misled, stretch, size), needs="newton_mm")


def models(stress: Stress) -> list[str]:
    """Names of the models that are tried."""
    return [name for name in names("fem") if not stress.needs or stress.needs in field_names("fem", name)]


def attempt(stress: Stress, name: str, heard: Heard) -> Result:
    """Simulate; raises LabError where the model stops."""
    model: Any = plugin("fem", name)
    known = field_names("fem", name)
    asked = {"edge_mm": EDGE_MM, "timeout_s": 600.0, **stress.fields}
    fem: Fem = model(**{key: value for key, value in asked.items() if key in known})
    with heard, stress.meddle():
        found = fem.simulate(stress.finger, OBSERVATION)
    return judged(found, stress)


def judged(found: Dataset, stress: Stress) -> Result:
    """What is wrong with a simulation of the scene of a stress, by its truth."""
    finger = stress.even or stress.finger
    true = reference(_Same(finger), stress.edge_mm, stress.contact)
    if true is None:
        return Result(WRONG_WITHOUT_EQUILIBRIUM, (UNSTABLE,))
    error = _error(found, float(finger.face(OBSERVATION.points).y_mm), true)
    crossed = true.fine.touches and error > GOOD if found.body is None else overlaps(found.body)
    stated = found.provenance.get("discretisation_error")
    bars = (_mesh_bar(found, stated["tip_mm"], true),) if stated and not crossed else ()
    causes = [cause for cause, is_so in ((UNSTABLE, true.unstable), (CONTACT, crossed)) if is_so]
    return Result(error, tuple(causes), bars)


def _error(found: Dataset, y_mm: float, true: Truth) -> float:
    """Largest error of the side face, and of the way across of the tip, relative to the largest displacement."""
    x, z = found.domain.points_mm.T
    face = true.at(np.stack([x, np.full_like(x, y_mm), z], axis=1))[:, [0, 2]]
    tip = np.insert(found.domain.points_mm[found.domain.base[-1]], 1, 0.0)  # in the plane of symmetry
    across, own = true.at(tip[None])[0, 1], 0.0
    if found.body is not None:
        own = found.body.displacements[-1][np.linalg.norm(found.body.domain.points_mm - tip, axis=1).argmin(), 1]
    size = max(np.linalg.norm(face, axis=1).max(), abs(across))
    return float(max(np.linalg.norm(found.displacements[-1] - face, axis=1).max(), abs(own - across)) / size)


def _mesh_bar(found: Dataset, stated_mm: float, true: Truth) -> Bar:
    """The stated change at the tip against the true error there, of the equilibrium that it was stated of."""
    assert found.body is not None
    x = found.body.domain.points_mm[:, 0]
    end = x >= x.max() - END * np.ptp(x)
    errors = np.linalg.norm(found.body.displacements[-1][end] - true.fine.at(found.body.domain.points_mm[end]), axis=1)
    ratio = float(errors.max() / stated_mm)
    return Bar("mesh", ratio <= WIDE, float((errors <= WIDE * stated_mm).mean()), ratio, ratio)


@dataclass(frozen=True)
class _Same:
    """A finger as a key: fingers hold lists."""

    finger: Finger

    def __hash__(self) -> int:
        return hash(repr(self.finger) + type(self.finger).__qualname__)


@cache
def reference(key: _Same, edge_mm: float, contact: str) -> Truth | None:
    """The truth of a finger, found once."""
    return truth_of(key.finger, edge_mm, contact)


def _changed(finger: Finger, **changes: Any) -> Finger:
    """`finger` with other fields, as far as it has them."""
    given: Any = finger
    return replace(given, **{key: value for key, value in changes.items() if hasattr(finger, key)})


def _low(finger: Finger, high_mm: float) -> Finger:
    """`finger` with one chamber, wide, 40 mm long and `high_mm` high, of a rubber so soft that its ceiling sags."""
    flat = {"channel_mm": high_mm / 4, "bridge_mm": high_mm / 4, "height_mm": high_mm + 1.5, "wall_mm": 1.5}
    wide = {"chambers": 1, "chamber_length_mm": 40.0, "width_mm": 24.0, "side_wall_mm": 2.0, "base_mm": 10.0}
    return replace(_changed(finger, **flat, **wide, max_kpa=1e-3), material=SOFT)


def _narrow(finger: Finger, chambers: int, gravity_m_s2: float) -> Finger:
    """`finger`, narrow and high, so that it tips over under `gravity_m_s2` sooner than it bends."""
    shape = {"width_mm": 6.0, "side_wall_mm": 1.5, "height_mm": 30.0, "base_mm": 12.0, "max_kpa": 1.0}
    return _changed(finger, chambers=chambers, gravity_m_s2=[0.0, -gravity_m_s2], **shape)


def distorted(finger: Finger, share: float) -> Finger:
    """`finger` with nodes moved at random by up to `share` of the shortest edge there, its body as it was.

    Inner nodes move in all directions; those on the surface along y only, between planes where it changes.
    """
    base: Any = type(finger)

    def mesh(self: Any, edge_mm: float) -> Any:
        even = base.mesh(self, edge_mm)
        rng = np.random.default_rng(0)
        ends = even.p[:, even.edges]
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=0)
        shortest = np.full(even.p.shape[1], np.inf)
        for end in even.edges:
            np.minimum.at(shortest, end, length)
        moved = share * shortest * rng.uniform(-1, 1, even.p.shape)
        planes = np.unique(base.mesh(self, float(np.ptp(even.p))).p[1])
        surface = even.boundary_nodes()
        moved[:, surface] *= np.array([[0.0], [1.0], [0.0]]) * ~np.isin(even.p[1, surface], planes)
        return type(even)(even.p + moved, even.t).with_boundaries(dict(even.boundaries))

    twisted = type(base.__name__, (base,), {"mesh": mesh, "__qualname__": f"{base.__qualname__} {share:.0%}"})
    return twisted(**{field.name: getattr(finger, field.name) for field in fields(base)})


@contextmanager
def _set(module: Any, name: str, value: Any) -> Iterator[None]:
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)


@contextmanager
def _steps(count: int) -> Iterator[None]:
    """Begin with pressure steps of 1/count of the path, and take none larger; CalculiX sizes the later ones itself."""
    with ExitStack() as stack:
        stack.enter_context(_set(calculix_deck, "FIRST_PRESSURE", 1 / count))
        stack.enter_context(_set(loading, "FIRST_PRESSURE", 1 / count))
        stack.enter_context(_set(path, "LARGEST_STEP", 1 / count))
        yield


@contextmanager
def _misled(stretch: float, size_mm: float) -> Iterator[None]:
    """Let Newton's method start `stretch` times as far from the nearest equilibrium and up to `size_mm` off."""
    rng, solve = np.random.default_rng(0), loading.LoadLeg.solve

    def misled(leg: loading.LoadLeg, start: Any, parameter: float) -> Any:
        if leg._found:  # nothing was predicted before
            before = leg._found[min(leg._found, key=lambda known: abs(known - parameter))]
            off = size_mm * rng.uniform(-1, 1, start.shape) * leg.equilibrium.free
            start = before + stretch * (start - before) + off
        return solve(leg, start, parameter)

    with _set(loading.LoadLeg, "solve", misled):
        yield
