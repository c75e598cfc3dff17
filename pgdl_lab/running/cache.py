"""Each simulation is computed once: snapshots are kept under a hash of everything that determines them."""

import hashlib
import json
import logging
import os
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pgdl_lab.core import sources
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import VERSION, DamagedDataset
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.heard import ASIDE, WARNINGS, heard
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import describe
from pgdl_lab.mechanics.fem import Fem, SimulationStopped
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.resultcheck import doubts
from pgdl_lab.mechanics.whole_body import observed

_log = logging.getLogger(__name__)

STOPPED = "stopped"  # in the provenance: why a simulation ended before its highest pressure


def snapshot_path(folder: Path, finger: Finger, fem: Fem, observation: Observation) -> Path:
    """Where the snapshots of this simulation lie in `folder`, computed or not.

    The name holds a hash of the configuration, of what was read from the files that it names, of all code that turns
    it into numbers and of the versions of the libraries and programs that this code uses.

    Raises
    ------
    InputError
        When a file of the finger is missing or cannot be read.
    """
    key = {
        "version": VERSION,
        "finger": describe(finger),
        "fem": describe(fem),
        "observation": {name: value for name, value in vars(observation).items() if name != "of"},  # serves both
        "programs": dict(fem.programs()),
        "code": sources.digest({*_classes(finger), *_classes(fem), doubts}),
        "content": [_hashed(content) for content in finger.content()],
    }
    name = f"{describe(finger)['name']}-{describe(fem)['name']}"
    return folder / f"{name}-{hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:16]}.h5"


def _hashed(content: bytes | NDArray[Any]) -> str:
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    return f"{content.dtype} {content.shape} {hashlib.sha256(content.tobytes()).hexdigest()}"


def _classes(value: Any) -> Iterator[type]:
    """Class of a plugin and of the plugins in its fields."""
    if is_dataclass(value):
        yield type(value)
        value = [getattr(value, field.name) for field in fields(value)]
    if isinstance(value, list | tuple | dict):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _classes(each)


def simulate(finger: Finger, fem: Fem, observation: Observation, folder: Path) -> tuple[Dataset, Path, bool]:
    """What is observed of a simulation, from `folder` if it is there, else computed and kept there.

    Runs that ask for the same simulation at the same time wait for the first of them. What the simulation warned of
    is told each time, and kept with the snapshots.

    Returns
    -------
    snapshots
        The dataset.
    path
        Its file.
    cached
        Whether it was there already.

    Raises
    ------
    InputError
        When the whole body is to be observed, and `fem` has none.
    LabError
        When `folder` cannot be written.
    SimulationStopped
        When the finger cannot bear the highest pressure; what converged is kept in a file of its own, named in the
        message, and found again like all other snapshots.
    """
    snapshots, path, cached = _simulated(finger, fem, observation, folder)
    return observed(snapshots, observation), path, cached


def _simulated(finger: Finger, fem: Fem, observation: Observation, folder: Path) -> tuple[Dataset, Path, bool]:
    """As `simulate`, of the side face with the whole body beside it."""
    from filelock import FileLock

    path = snapshot_path(folder, finger, fem, observation)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = FileLock(path.with_suffix(".lock")).acquire()
    except OSError as error:
        raise LabError(f"{folder} cannot be written ({error.strerror}): free it or set PGDL_LAB_ROOT.") from error
    with held:
        kept, partial = _kept(path), path.with_name(f"{path.stem}-stopped.h5")
        if kept is not None:
            return kept, path, True
        stopped = _kept(partial)
        if stopped is None:
            snapshots = _computed(fem, finger, observation)
            if STOPPED not in snapshots.provenance:
                snapshots.save(path)
                return snapshots, path, False
            snapshots.save(partial)
            stopped = snapshots
        raise SimulationStopped(
            f"{stopped.provenance[STOPPED]} What converged is kept in {partial}; delete it to try again.", stopped
        )


def _kept(path: Path) -> Dataset | None:
    """The snapshots at `path`, whose warnings are told; None if there are none that can be read: they are set aside."""
    if not path.exists():
        return None
    try:
        snapshots = Dataset.load(path)
    except DamagedDataset as error:
        aside = path.with_suffix(".damaged")
        os.replace(path, aside)
        _log.warning("%s It is set aside as %s, and the simulation is run again.", error, aside.name, extra=ASIDE)
        return None
    for sentence in snapshots.warnings:
        _log.warning("%s", sentence)
    return snapshots


def _computed(fem: Fem, finger: Finger, observation: Observation) -> Dataset:
    """Snapshots of a simulation, with what was warned of and, if it stopped, why."""
    with heard() as sentences:
        try:
            snapshots = fem.simulate(finger, observation)
        except SimulationStopped as stop:
            snapshots = stop.snapshots
            snapshots.provenance[STOPPED] = str(stop)
        for sentence in (*finger.doubts(), *doubts(snapshots, finger)):
            _log.warning("%s", sentence)
    snapshots.provenance[WARNINGS] = sentences
    return snapshots
