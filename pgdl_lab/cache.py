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

from pgdl_lab import sources
from pgdl_lab.errors import LabError
from pgdl_lab.fem import Fem, SimulationStopped
from pgdl_lab.finger import Finger
from pgdl_lab.heard import WARNINGS, heard
from pgdl_lab.registry import describe
from pgdl_lab.snapshots import VERSION, DamagedSnapshots, Observation, Snapshots

_log = logging.getLogger(__name__)


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
        "observation": vars(observation).copy(),
        "programs": dict(fem.programs()),
        "code": sources.digest({*_classes(finger), *_classes(fem)}),
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


def simulate(finger: Finger, fem: Fem, observation: Observation, folder: Path) -> tuple[Snapshots, Path, bool]:
    """Snapshots of a simulation, from `folder` if they are there, else computed and kept there.

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
    LabError
        When `folder` cannot be written.
    SimulationStopped
        When the finger cannot bear the highest pressure; what converged is kept in a file of its own, named in the
        message.
    """
    from filelock import FileLock

    path = snapshot_path(folder, finger, fem, observation)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path.with_suffix(".lock"))
        lock.acquire()
    except OSError as error:
        raise LabError(f"{folder} cannot be written ({error.strerror}): free it or set PGDL_LAB_ROOT.") from error
    with lock:
        if path.exists():
            try:
                snapshots = Snapshots.load(path)
            except DamagedSnapshots as error:
                aside = path.with_suffix(".damaged")
                os.replace(path, aside)
                _log.warning("%s It is set aside as %s, and the simulation is run again.", error, aside.name)
            else:
                for sentence in snapshots.warnings:
                    _log.warning("%s", sentence)
                return snapshots, path, True
        try:
            with heard() as sentences:
                snapshots = fem.simulate(finger, observation)
        except SimulationStopped as stop:
            if not len(stop.snapshots.pressures_kpa):
                raise
            stop.snapshots.provenance[WARNINGS] = sentences
            partial = path.with_name(f"{path.stem}-stopped.h5")
            stop.snapshots.save(partial)
            raise SimulationStopped(f"{stop} What converged is kept in {partial}.", stop.snapshots) from None
        snapshots.provenance[WARNINGS] = sentences
        snapshots.save(path)
    return snapshots, path, False
