"""Each simulation is computed once: snapshots are kept under a hash of everything that determines them."""

import hashlib
import inspect
import json
import logging
import os
from pathlib import Path

from pgdl_lab import mechanics
from pgdl_lab.errors import LabError
from pgdl_lab.fem import Fem, SimulationStopped
from pgdl_lab.finger import Finger
from pgdl_lab.registry import describe
from pgdl_lab.resultcheck import WARNINGS, doubts
from pgdl_lab.snapshots import VERSION, DamagedSnapshots, Observation, Snapshots

_log = logging.getLogger(__name__)

STOPPED = "stopped"  # in the provenance: why a simulation ended before its highest pressure


def snapshot_path(folder: Path, finger: Finger, fem: Fem, observation: Observation) -> Path:
    """Where the snapshots of this simulation lie in `folder`, computed or not.

    The name holds a hash of the configuration, of the files that it names and of the code that turns it into numbers,
    so that neither a changed field or file nor an edited plugin meets old results.
    """
    folders = [Path(entry) for entry in mechanics.__path__]
    code = sorted(path for entry in folders for path in entry.glob("*.py"))
    code += [Path(inspect.getfile(type(part))) for part in (finger, finger.material, fem)]
    digest = hashlib.sha256()
    what = [VERSION, describe(finger), describe(fem), [observation.snapshots, observation.points]]
    digest.update(json.dumps(what, sort_keys=True).encode())
    for path in code:
        digest.update(path.read_bytes())
    for path in finger.files():
        digest.update(path.read_bytes())
    return folder / f"{describe(finger)['name']}-{describe(fem)['name']}-{digest.hexdigest()[:16]}.h5"


def simulate(finger: Finger, fem: Fem, observation: Observation, folder: Path) -> tuple[Snapshots, Path, bool]:
    """Snapshots of a simulation, from `folder` if they are there, else computed and kept there.

    Runs that ask for the same simulation at the same time wait for the first of them.

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
        message, and found again like all other snapshots.
    """
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
            try:
                snapshots = fem.simulate(finger, observation)
            except SimulationStopped as stop:
                stopped = stop.snapshots
                stopped.provenance[STOPPED] = str(stop)
                _warn(stopped, finger)
                stopped.save(partial)
            else:
                _warn(snapshots, finger)
                snapshots.save(path)
                return snapshots, path, False
        raise SimulationStopped(
            f"{stopped.provenance[STOPPED]} What converged is kept in {partial}; delete it to try again.", stopped
        )


def _kept(path: Path) -> Snapshots | None:
    """The snapshots at `path`; None if there are none that can be read, which are set aside."""
    if not path.exists():
        return None
    try:
        return Snapshots.load(path)
    except DamagedSnapshots as error:
        aside = path.with_suffix(".damaged")
        os.replace(path, aside)
        _log.warning("%s It is set aside as %s, and the simulation is run again.", error, aside.name)
        return None


def _warn(snapshots: Snapshots, finger: Finger) -> None:
    """Tell what of finger and result may not be as meant; it goes with the snapshots."""
    found = [*finger.doubts(), *doubts(snapshots, finger)]
    for sentence in found:
        _log.warning(sentence)
    snapshots.provenance[WARNINGS] = [*snapshots.provenance.get(WARNINGS, []), *found]
