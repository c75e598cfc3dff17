"""All trials of the failure map, each from the store or made now."""

import hashlib
import json
import logging
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

from pgdl_lab.core import sources
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe, plugin
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.running.cache import simulate
from pgdl_lab.studies.stability import learning, mechanics
from pgdl_lab.studies.stability.outcome import Attempt, Heard, Result, Trial, tried
from pgdl_lab.studies.stability.verdict import judge

_log = logging.getLogger(__name__)

DATA = Observation(snapshots=20, points=400)
DATA_EDGE_MM = 6.0
PARTS: dict[str, tuple[str, Any]] = {"mechanics": ("fem", mechanics.attempt), "learning": ("model", learning.attempt)}
"""Of each part the kind of plugin that is tried, and what tries it."""


@dataclass(frozen=True)
class StabilitySettings:
    """How much is tried.

    Attributes
    ----------
    parts
        "mechanics", "learning" or both.
    seeds
        Number of seeds of each training.
    updates
        Steps of the optimiser in each training of a network.
    finger
        Name and fields of the short finger.
    touching
        Fields of it with which chambers touch below its highest pressure.
    """

    parts: list[str]
    seeds: int
    updates: int
    finger: dict[str, Any]
    touching: dict[str, Any]

    def __post_init__(self) -> None:
        for part in self.parts:
            if part not in PARTS:
                raise InputError(f"stability.parts names '{part}'; choose among {' and '.join(PARTS)}.")
        if self.seeds < 1:
            raise InputError(f"stability.seeds is {self.seeds}; it must be at least 1.")
        if self.updates < 1:
            raise InputError(f"stability.updates is {self.updates}; it must be at least 1.")


@dataclass(frozen=True)
class Planned:
    """A trial that can be made.

    Attributes
    ----------
    part, axis, level, method, seed
        See `Trial`.
    path
        Where it is kept once it is made.
    attempt
        What is tried.
    """

    part: str
    axis: str
    level: str
    method: str
    seed: int
    path: Path
    attempt: Attempt

    def trial(self) -> Trial:
        """The trial from its file, or made now."""
        if self.path.is_file():
            return Trial.of(json.loads(self.path.read_text(encoding="utf-8")))
        trial = tried(self.part, self.axis, self.level, self.method, self.attempt, self.seed)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(self.path) as temporary:
            temporary.write_text(json.dumps(asdict(trial), indent=1), encoding="utf-8")
        return trial


def planned(settings: StabilitySettings, quick: bool, folder: Path) -> list[Planned]:
    """Every method under every stress that reaches it; simulations and trials are kept in `folder`."""
    finger = _finger(settings.finger)
    found: list[Planned] = []
    if "mechanics" in settings.parts:
        for stress in mechanics.stresses(finger, quick):
            for name in mechanics.models(stress):
                what: list[Any] = [describe(stress.finger), type(stress.finger).__qualname__, stress.fields]
                what += [stress.edge_mm, stress.contact]
                path = _path(folder, finger, stress, name, what)
                attempt = partial(mechanics.attempt, stress, name)
                found.append(Planned("mechanics", stress.axis, stress.level, name, 0, path, attempt))
    if "learning" in settings.parts:
        scenes = {"smooth": finger, "touching": _finger({**settings.finger, **settings.touching})}

        @cache
        def data(scene: str) -> Dataset:
            return _simulated(scenes[scene], folder)

        tries = product(range(settings.seeds), learning.stresses(quick))  # a map with fewer seeds comes first
        for seed, training in tries:
            for name in learning.models(training):
                what = [asdict(training), describe(scenes[training.data]), seed, settings.updates]
                path = _path(folder, finger, training, name, what)

                def learn(
                    heard: Heard, training: learning.Stress = training, name: str = name, seed: int = seed
                ) -> Result:
                    scene, updates = training.data, settings.updates
                    return learning.attempt(training, name, data(scene), scenes[scene], seed, updates, heard)

                found.append(Planned("learning", training.axis, training.level, name, seed, path, learn))
    return found


def all_trials(settings: StabilitySettings, quick: bool, folder: Path) -> Iterator[Trial]:
    """The trials in turn; says how far it has come and how long the others may take."""
    plan = planned(settings, quick, folder)
    missing, made, began = sum(not each.path.is_file() for each in plan), 0, time.perf_counter()
    for each in plan:
        is_new = not each.path.is_file()
        trial = each.trial()
        if is_new:
            made += 1
            left_min = (time.perf_counter() - began) / made * (missing - made) / 60
            _log.info(
                "%d of %d, about %.0f min left: %s, %s, %s: %s", made, missing, left_min, trial.axis, trial.level,
                trial.method, judge(trial).outcome,
            )  # fmt: skip
        yield trial


def _finger(description: dict[str, Any]) -> Finger:
    fields = dict(description)
    made: Finger = plugin("finger", fields.pop("name"))(**fields)
    return made


def _simulated(finger: Finger, folder: Path) -> Dataset:
    solid = plugin("fem", "solid")(edge_mm=DATA_EDGE_MM, estimate_error=False)
    return simulate(finger, solid, DATA, folder / "snapshots")[0]


def _path(folder: Path, finger: Finger, stress: Any, method: str, what: Any) -> Path:
    """Where a trial is kept: under a hash of the stress and of the code that is tried, on a finger."""
    part = "mechanics" if isinstance(stress, mechanics.Stress) else "learning"
    key = [part, _code(part, method, type(finger), type(finger.material)), stress.axis, stress.level, method, what]
    digest = hashlib.sha256(json.dumps(key, sort_keys=True, default=str).encode())
    return folder / "stability" / f"{digest.hexdigest()[:20]}.json"


@cache
def _code(part: str, method: str, *finger: type) -> str:
    """Hash of all code that decides how a trial ends; surrogates learn from the solid."""
    kind, attempt = PARTS[part]
    return sources.digest([plugin(kind, method), attempt, plugin("fem", "solid"), *finger])
