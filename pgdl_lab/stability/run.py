"""All trials of the failure map, each from the store or made now."""

import hashlib
import inspect
import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pgdl_lab
from pgdl_lab.cache import simulate
from pgdl_lab.errors import InputError
from pgdl_lab.files import replacing
from pgdl_lab.finger import Finger
from pgdl_lab.registry import describe, plugin
from pgdl_lab.snapshots import Observation, Snapshots
from pgdl_lab.stability import learning, mechanics
from pgdl_lab.stability.outcome import Trial, tried

_log = logging.getLogger(__name__)

DATA = Observation(snapshots=20, points=400)
DATA_EDGE_MM = 6.0
CODE = ("mechanics/*.py", "learning/*.py", "stability/[!pr]*.py")
"""Files of the package that decide how a trial ends."""


@dataclass(frozen=True)
class StabilitySettings:
    """How much is tried.

    Attributes
    ----------
    parts
        "mechanics", "learning" or both.
    seeds
        Number of seeds of each training.
    train_s
        Budget of each training [s].
    finger
        Name and fields of the short finger.
    touching
        Fields of it with which chambers touch below its highest pressure.
    """

    parts: list[str]
    seeds: int
    train_s: float
    finger: dict[str, Any]
    touching: dict[str, Any]

    def __post_init__(self) -> None:
        for part in self.parts:
            if part not in ("mechanics", "learning"):
                raise InputError(f"stability.parts names '{part}'; choose among mechanics and learning.")
        if self.seeds < 1:
            raise InputError(f"stability.seeds is {self.seeds}; it must be at least 1.")
        if not self.train_s > 0:
            raise InputError(f"stability.train_s is {self.train_s} s; it must be above 0.")


def all_trials(settings: StabilitySettings, quick: bool, folder: Path) -> Iterator[Trial]:
    """Every method under every stress; simulations and trials are kept in `folder`."""
    store = _Store(folder / "stability", quick)
    finger = _finger(settings.finger)
    if "mechanics" in settings.parts:
        for stress in mechanics.stresses(finger, quick):
            for name in mechanics.models():
                what: list[Any] = [describe(stress.finger), type(stress.finger).__qualname__, stress.fields]
                yield store.trial(
                    "mechanics", stress.axis, stress.level, name, what, "fem",
                    partial(mechanics.attempt, stress, name),
                )  # fmt: skip
    if "learning" in settings.parts:
        data: dict[str, Snapshots] = {}
        scenes = {"smooth": finger, "touching": _finger({**settings.finger, **settings.touching})}
        for training in learning.stresses(quick):
            for name in learning.models():
                for seed in range(settings.seeds):
                    what = [asdict(training), describe(scenes[training.data]), seed, settings.train_s]

                    def attempt(training: Any = training, name: str = name, seed: int = seed) -> Any:
                        if training.data not in data:
                            data[training.data] = _simulated(scenes[training.data], folder)
                        given = data[training.data], scenes[training.data]
                        return learning.attempt(training, name, *given, seed, settings.train_s)

                    yield store.trial("learning", training.axis, training.level, name, what, "model", attempt)


def _finger(description: dict[str, Any]) -> Finger:
    fields = dict(description)
    made: Finger = plugin("finger", fields.pop("name"))(**fields)
    return made


def _simulated(finger: Finger, folder: Path) -> Snapshots:
    solid = plugin("fem", "solid")(edge_mm=DATA_EDGE_MM, estimate_error=False)
    return simulate(finger, solid, DATA, folder / "snapshots")[0]


class _Store:
    """Trials as files, one each, under a hash of the stress and of the code that is tried."""

    def __init__(self, folder: Path, quick: bool) -> None:
        self.folder, self.quick = folder, quick
        package = Path(inspect.getfile(pgdl_lab)).parent
        self._code = b"".join(path.read_bytes() for name in CODE for path in sorted(package.glob(name)))

    def trial(
        self, part: str, axis: str, level: str, method: str, what: Any, kind: str, attempt: Callable[[], Any]
    ) -> Trial:
        digest = hashlib.sha256(self._code + Path(inspect.getfile(plugin(kind, method))).read_bytes())
        digest.update(json.dumps([part, axis, level, method, what], sort_keys=True, default=str).encode())
        path = self.folder / f"{digest.hexdigest()[:20]}.json"
        if path.is_file():
            return Trial(**json.loads(path.read_text(encoding="utf-8")))
        trial = tried(part, axis, level, method, attempt)
        _log.info("%s, %s, %s: %s", axis, level, method, "SILENTLY WRONG" if trial.silent else trial.mode)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(asdict(trial), indent=1), encoding="utf-8")
        return trial
