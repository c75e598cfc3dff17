"""Finite-element models under stress: load steps, incompressibility, thin walls, gravity, pressure, meshes, contact.

Each trial is compared with the solid on half the edges in the same scene. Where that finds no equilibrium, a model that
finds one without a word is wrong.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import Any

import numpy as np

from pgdl_lab.errors import LabError
from pgdl_lab.fem import Fem
from pgdl_lab.finger import Finger
from pgdl_lab.mechanics import calculix_deck, finite_strain, path
from pgdl_lab.registry import field_names, names, plugin
from pgdl_lab.snapshots import Observation, Snapshots
from pgdl_lab.stability.outcome import Result

OBSERVATION = Observation(snapshots=4, points=300)
EDGE_MM = 6.0
MAX_KPA = 20.0
WRONG_WITHOUT_EQUILIBRIUM = 1.0  # relative error of a result where there is none to compare with


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
    """

    axis: str
    level: str
    finger: Finger
    fields: dict[str, Any]
    meddle: Callable[[], AbstractContextManager[None]] = nullcontext
    even: Finger | None = None
    needs: str = ""


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
        yield Stress("contact sets in", mode, touching, given, needs=next(iter(given), ""))
    for told, stretch, size in levels(
        ("as it is", 1.0, 0.0), ("the last equilibrium", 0.0, 0.0), ("too far by half", 1.5, 0.0),
        ("0.03 mm off", 1.0, 0.03), ("0.3 mm off", 1.0, 0.3), ("1 mm off", 1.0, 1.0),
    ):  # fmt: skip
        yield Stress("poor predictor", told, finger, {}, partial(_misled, stretch, size), needs="newton_mm")


def models(stress: Stress) -> list[str]:
    """Names of the models that are tried."""
    return [name for name in names("fem") if not stress.needs or stress.needs in field_names("fem", name)]


def attempt(stress: Stress, name: str) -> Result:
    """Simulate; raises LabError where the model stops."""
    model: Any = plugin("fem", name)
    known = field_names("fem", name)
    asked = {"edge_mm": EDGE_MM, "timeout_s": 30.0, **stress.fields}
    fem: Fem = model(**{key: value for key, value in asked.items() if key in known})
    with stress.meddle():
        found = fem.simulate(stress.finger, OBSERVATION)
    truth = reference(_Same(stress.even or stress.finger))
    if truth is None:
        return Result(WRONG_WITHOUT_EQUILIBRIUM)
    size = np.linalg.norm(truth.displacements[-1], axis=1).max()
    return Result(float(np.linalg.norm(found.displacements[-1] - truth.displacements[-1], axis=1).max() / size))


@dataclass(frozen=True)
class _Same:
    """A finger as a key: fingers hold lists."""

    finger: Finger

    def __hash__(self) -> int:
        return hash(repr(self.finger) + type(self.finger).__qualname__)


@cache
def reference(key: _Same) -> Snapshots | None:
    """The solid on half the edges, or None if it finds no equilibrium."""
    solid: Any = plugin("fem", "solid")
    try:
        found: Snapshots = solid(edge_mm=EDGE_MM / 2, estimate_error=False).simulate(key.finger, OBSERVATION)
    except LabError:
        return None
    return found


def _changed(finger: Finger, **changes: Any) -> Finger:
    """`finger` with other fields, as far as it has them."""
    given: Any = finger
    return replace(given, **{key: value for key, value in changes.items() if hasattr(finger, key)})


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
        stack.enter_context(_set(finite_strain, "FIRST_PRESSURE", 1 / count))
        stack.enter_context(_set(path, "LARGEST_STEP", 1 / count))
        yield


@contextmanager
def _misled(stretch: float, size_mm: float) -> Iterator[None]:
    """Let Newton's method start `stretch` times as far from the nearest equilibrium and up to `size_mm` off."""
    rng, solve = np.random.default_rng(0), finite_strain.LoadLeg.solve

    def misled(leg: finite_strain.LoadLeg, start: Any, parameter: float) -> Any:
        if leg._found:  # nothing was predicted before
            before = leg._found[min(leg._found, key=lambda known: abs(known - parameter))]
            off = size_mm * rng.uniform(-1, 1, start.shape) * leg.equilibrium.free
            start = before + stretch * (start - before) + off
        return solve(leg, start, parameter)

    with _set(finite_strain.LoadLeg, "solve", misled):
        yield
