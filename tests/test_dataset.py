"""The snapshot file and the cache: kept whole, recognised when not, computed once."""

import json
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from omegaconf import OmegaConf

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import DISPLACEMENT, DamagedDataset
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.registry import plugin
from pgdl_lab.mechanics.fem import Fem, SimulationStopped
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.resultcheck import doubts
from pgdl_lab.running.cache import simulate, snapshot_path
from pgdl_lab.tasks import Job
from pgdl_lab.tasks import simulate as task
from tests.fingers import OBSERVATION, balloon, pneunet, solid


def small() -> Dataset:
    random = np.random.default_rng(0)
    face = Domain(
        random.normal(size=(5, 2)), np.array([[0, 1, 2], [2, 3, 4]]), base=np.array([0, 1]), clamp=np.array([0])
    )
    brick = Domain(random.normal(size=(8, 3)), np.arange(8)[None], "hexahedron")
    return Dataset.path(
        face,
        np.array([1.0, 2.0, 3.0]),
        random.normal(size=(3, 5, 2)),
        body=Dataset.path(brick, np.array([0.0, 3.0]), random.normal(size=(2, 8, 3))),
        provenance={"finger": {"name": "pneunet", "gap_mm": 1.0}, "versions": {"numpy": "2"}},
    )


def assert_equal(one: Dataset, other: Dataset) -> None:
    for name in ("points_mm", "cells", "base", "clamp"):
        np.testing.assert_array_equal(getattr(one.domain, name), getattr(other.domain, name))
    for name in ("values", "simulation"):
        np.testing.assert_array_equal(getattr(one.cases, name), getattr(other.cases, name))
    for name in ("displacements", "pressures_kpa"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.cases.inputs == other.cases.inputs and one.domain.cell_type == other.domain.cell_type
    assert one.provenance == other.provenance


def test_file_gives_back_what_was_written(tmp_path: Path) -> None:
    written = small()
    written.save(tmp_path / "a.h5")
    read = Dataset.load(tmp_path / "a.h5")
    assert_equal(read, written)
    assert read.body is not None and written.body is not None
    assert read.body.domain.cell_type == "hexahedron"
    np.testing.assert_array_equal(read.body.displacements, written.body.displacements)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_no_body(tmp_path: Path) -> None:
    replace(small(), body=None).save(tmp_path / "a.h5")
    assert Dataset.load(tmp_path / "a.h5").body is None


@pytest.mark.parametrize("kept", [0, 100, 2000, -1])
def test_truncated_file_is_recognised(tmp_path: Path, kept: int) -> None:
    small().save(tmp_path / "a.h5")
    whole = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(whole[:kept])
    with pytest.raises(DamagedDataset, match=r"a\.h5"):
        Dataset.load(tmp_path / "a.h5")


def test_altered_number_is_recognised(tmp_path: Path) -> None:
    written = small()
    written.save(tmp_path / "a.h5")
    content = (tmp_path / "a.h5").read_bytes()
    number = written.displacements[1, 2, 0].tobytes()
    assert content.count(number) == 1
    (tmp_path / "a.h5").write_bytes(content.replace(number, np.float64(7.0).tobytes()))
    with pytest.raises(DamagedDataset):
        Dataset.load(tmp_path / "a.h5")


def test_foreign_files_are_recognised(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["points_mm"] = np.zeros(3)
    with pytest.raises(DamagedDataset, match="does not hold a dataset of pgdl_lab"):
        Dataset.load(tmp_path / "a.h5")
    (tmp_path / "b.h5").write_text("x,z,p\n1,2,3\n")
    with pytest.raises(DamagedDataset, match="no readable dataset"):
        Dataset.load(tmp_path / "b.h5")


def test_other_version_is_named(tmp_path: Path) -> None:
    small().save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file.attrs["version"] = 99
    with pytest.raises(DamagedDataset, match="version 99 of the format, but this is version 2"):
        Dataset.load(tmp_path / "a.h5")


@pytest.mark.parametrize(
    "change",
    [
        {"cases": replace(small().cases, simulation=np.zeros(2, dtype=np.int64))},
        {"cases": replace(small().cases, simulation=np.zeros(3))},
        {"cases": replace(small().cases, values=np.ones((3, 2)))},
        {"cases": replace(small().cases, values=np.full((3, 1), np.nan))},
        {"cases": Cases.path(np.array([1.0, 2.0]))},
        {"fields": {}},
        {"fields": {DISPLACEMENT: np.zeros((3, 5, 3))}},
        {"fields": {DISPLACEMENT: np.zeros((3, 5, 2)), "stress_mpa": np.zeros((3, 4, 6))}},
        {"fields": {DISPLACEMENT: np.full((3, 5, 2), np.inf)}},
        {"body": replace(small(), cases=Cases.path(np.ones(2)))},
        {"provenance": []},
    ],
)
def test_what_is_no_dataset_is_noticed(change: dict[str, Any]) -> None:
    assert small().fits() and not replace(small(), **change).fits()


def test_files_of_the_first_version_are_read(tmp_path: Path) -> None:
    known, body = small(), small().body
    assert body is not None
    with h5py.File(tmp_path / "old.h5", "w") as file:
        file.attrs.update(format="pgdl_lab snapshots", version=1, provenance=json.dumps(known.provenance))
        domain, brick, group = known.domain, body.domain, file.create_group("body")
        file["points"], file["triangles"], file["base"] = domain.points_mm, domain.cells, domain.base
        file["clamp"], file["pressures_kpa"], file["displacements"] = domain.clamp, [1.0, 2.0, 3.0], known.displacements
        group["positions"], group["cells"], group["pressures_kpa"] = brick.points_mm, brick.cells, [0.0, 3.0]
        group["displacements"], group.attrs["cell_type"] = body.displacements, "hexahedron"
    read = Dataset.load(tmp_path / "old.h5")
    assert_equal(read, known)
    assert read.body is not None
    assert_equal(read.body, body)


def test_arrays_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    replace(small(), fields={DISPLACEMENT: np.zeros((2, 5, 2))}).save(tmp_path / "a.h5")
    with pytest.raises(DamagedDataset, match="do not fit together"):
        Dataset.load(tmp_path / "a.h5")


@pytest.mark.parametrize(("field", "value"), [("snapshots", 0), ("points", 3)])
def test_observation_refuses_nothing_to_see(field: str, value: int) -> None:
    with pytest.raises(InputError, match=f"observation.{field} is {value}"):
        Observation(**{field: value})


@dataclass(frozen=True)
class Counting(Fem):
    """Notes each simulation in a file, and takes its time."""

    name = "counting"
    notes: str = ""
    seconds: float = 0.0

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        with Path(self.notes).open("a") as file:
            file.write(f"{os.getpid()}\n")
        time.sleep(self.seconds)
        return small()


def test_second_call_reads_the_cache(tmp_path: Path) -> None:
    fem = Counting(notes=str(tmp_path / "notes"))
    first, path, cached = simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")
    again, same_path, cached_again = simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")
    assert (cached, cached_again) == (False, True)
    assert path == same_path and path.name.startswith("pneunet-counting-")
    assert_equal(first, again)
    assert len((tmp_path / "notes").read_text().split()) == 1


def test_everything_that_determines_a_simulation_is_in_its_name(tmp_path: Path) -> None:
    fem, finger = Counting(), pneunet()
    paths = {
        snapshot_path(tmp_path, finger, fem, OBSERVATION),
        snapshot_path(tmp_path, pneunet(gap_mm=1.1), fem, OBSERVATION),
        snapshot_path(tmp_path, replace(finger, material=replace(finger.material, poisson=0.48)), fem, OBSERVATION),
        snapshot_path(tmp_path, replace(finger, material=plugin("material", "mooney_rivlin")()), fem, OBSERVATION),
        snapshot_path(tmp_path, finger, replace(fem, seconds=1.0), OBSERVATION),
        snapshot_path(tmp_path, finger, fem, replace(OBSERVATION, points=900)),
    }
    assert len(paths) == 6


def test_damaged_cache_is_set_aside_and_computed_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    fem = Counting(notes=str(tmp_path / "notes"))
    first, path, _ = simulate(pneunet(), fem, OBSERVATION, tmp_path)
    path.write_bytes(path.read_bytes()[:500])
    snapshots, _, cached = simulate(pneunet(), fem, OBSERVATION, tmp_path)
    assert not cached
    assert_equal(snapshots, first)
    assert path.with_suffix(".damaged").stat().st_size == 500
    assert path.name in caplog.text and "run again" in caplog.text


ERROR = {"kpa": 3.0, "tip_mm": 0.01, "tip_percent": 0.5, "largest_mm": 0.02}


@dataclass(frozen=True)
class Doubting(Fem):
    """Warns of its result, or stops."""

    name = "doubting"
    stops: bool = False

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        log = logging.getLogger("pgdl_lab.plugins.fem.doubting")
        for kpa in (3.0, 3.0):
            log.warning("The equilibria at %g kPa are unstable.", kpa)
        log.info("Nothing to worry about.")
        other = threading.Thread(target=log.warning, args=["Another simulation is unsure."])
        other.start()
        other.join()
        if self.stops:
            raise SimulationStopped("It burst.", small())
        return replace(small(), provenance={"discretisation_error": ERROR})


TOLD = ["The equilibria at 3 kPa are unstable.", *doubts(small(), pneunet())]


def test_what_a_simulation_warned_of_is_told_whenever_it_is_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first, path, _ = simulate(pneunet(), Doubting(), OBSERVATION, tmp_path)
    assert first.warnings == Dataset.load(path).warnings == TOLD
    for _ in range(2):
        caplog.clear()
        again, _, cached = simulate(pneunet(), Doubting(), OBSERVATION, tmp_path)
        assert cached and again.warnings == TOLD
        assert [record.getMessage() for record in caplog.records if record.levelname == "WARNING"] == TOLD


def test_metrics_of_a_simulation_hold_what_it_knows_of_its_error(root: Path) -> None:
    made: Any = SimpleNamespace(finger=pneunet(), fem=Doubting(), observation=OBSERVATION)
    task.run(Job(made, OmegaConf.create(), root, None))
    metrics = json.loads((root / "metrics.json").read_text())
    assert metrics["warnings"] == TOLD
    assert metrics["discretisation_error"] == ERROR


def test_what_a_stopped_simulation_warned_of_is_kept(tmp_path: Path) -> None:
    with pytest.raises(SimulationStopped):
        simulate(pneunet(), Doubting(stops=True), OBSERVATION, tmp_path)
    (kept,) = tmp_path.glob("*-stopped.h5")
    assert Dataset.load(kept).warnings == TOLD


def _simulate_in(folder: str, notes: str, seconds: float) -> None:
    simulate(pneunet(), Counting(notes=notes, seconds=seconds), OBSERVATION, Path(folder))


def test_parallel_runs_compute_a_scene_once(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    arguments = (str(tmp_path / "cache"), str(tmp_path / "notes"), 1.0)
    processes = [context.Process(target=_simulate_in, args=arguments) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0, 0]
    assert len((tmp_path / "notes").read_text().split()) == 1


def test_killed_simulation_leaves_nothing_and_blocks_nobody(tmp_path: Path) -> None:
    notes = tmp_path / "notes"
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_simulate_in, args=(str(tmp_path / "cache"), str(notes), 60.0))
    process.start()
    deadline = time.monotonic() + 30
    while not notes.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    fem = Counting(notes=str(notes), seconds=60.0)
    assert not snapshot_path(tmp_path / "cache", pneunet(), fem, OBSERVATION).exists()
    _, _, cached = simulate(pneunet(), replace(fem, seconds=0.0), OBSERVATION, tmp_path / "cache")
    assert not cached


def test_burst_keeps_what_converged(tmp_path: Path) -> None:
    with pytest.raises(
        SimulationStopped, match=r"equilibrium up to \d+.* kPa, but not at finger.max_kpa=300.* balloons or snaps"
    ) as caught:
        simulate(balloon(), solid(), OBSERVATION, tmp_path)
    (kept,) = tmp_path.glob("*-stopped.h5")
    assert str(kept) in str(caught.value)
    snapshots = Dataset.load(kept)
    assert 0 < len(snapshots.pressures_kpa) < OBSERVATION.snapshots
    assert snapshots.pressures_kpa[-1] <= 300
    limit, reached = snapshots.provenance["limit_kpa"], snapshots.provenance["equilibria_kpa"][-1]
    assert reached <= limit < 1.001 * reached and f"a maximum near {limit:.4g} kPa" in str(caught.value)
    assert not snapshot_path(tmp_path, balloon(), solid(), OBSERVATION).exists()


@dataclass(frozen=True)
class Stopping(Counting):
    """Stops each time, with as many snapshots as it is told."""

    name = "stopping"
    converged: int = 2

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        whole = super().simulate(finger, observation)
        kept = slice(0, self.converged)
        found = Dataset.path(
            whole.domain, whole.pressures_kpa[kept], whole.displacements[kept], provenance=whole.provenance
        )
        raise SimulationStopped(f"It stopped after {self.converged} snapshots.", found)


@pytest.mark.parametrize("converged", [2, 0])
def test_a_stopped_simulation_is_computed_once(converged: int, tmp_path: Path) -> None:
    fem = Stopping(notes=str(tmp_path / "notes"), converged=converged)
    told, pressures = [], []
    for _ in range(2):
        with pytest.raises(SimulationStopped, match=f"It stopped after {converged} snapshots. What converged") as stop:
            simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")
        told.append(str(stop.value))
        pressures.append(stop.value.snapshots.pressures_kpa)
    assert told[0] == told[1] and told[0].endswith("-stopped.h5; delete it to try again.")
    np.testing.assert_array_equal(*pressures)
    assert len(pressures[0]) == converged
    assert len((tmp_path / "notes").read_text().split()) == 1
    (kept,) = (tmp_path / "cache").glob("*-stopped.h5")
    kept.write_bytes(kept.read_bytes()[:500])  # damaged, it is computed again
    with pytest.raises(SimulationStopped):
        simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")
    kept.unlink()
    with pytest.raises(SimulationStopped):
        simulate(pneunet(), fem, OBSERVATION, tmp_path / "cache")
    assert len((tmp_path / "notes").read_text().split()) == 3


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="root can write everywhere")
def test_unwritable_cache(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(LabError, match="cannot be written"):
        simulate(pneunet(), Counting(), OBSERVATION, tmp_path / "cache")


def test_cache_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("")
    with pytest.raises(LabError, match="cannot be written"):
        simulate(pneunet(), Counting(), OBSERVATION, tmp_path / "cache")
