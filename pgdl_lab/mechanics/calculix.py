"""The program CalculiX: how it is found, run, watched and read."""

import os
import re
import resource
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import LabError
from pgdl_lab.mechanics.calculix_deck import deck, weighs
from pgdl_lab.mechanics.calculix_program import program
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.loading import progress
from pgdl_lab.mechanics.threads import threads

Array = NDArray[np.float64]

GLANCE_S = 0.2  # between two looks at the progress


@dataclass(frozen=True)
class Increment:
    """A line of the progress file: an increment, converged or not, up to a time of its step [s]."""

    step: int
    converged: bool
    iterations: int
    time_s: float


@dataclass(frozen=True)
class Course:
    """What CalculiX found.

    Attributes
    ----------
    pressures_kpa
        (K,) zero, then the observed pressures with an equilibrium [kPa].
    displacements
        (K, N, 3) of all nodes [mm].
    reached_kpa
        Highest pressure with an equilibrium, observed or not [kPa].
    trouble
        Why the highest pressure was not reached; empty if it was.
    increments, iterations
        Converged increments, and equilibrium iterations in all.
    cpu_seconds
        Processor time of the program, all threads together [s].
    threads
        What OMP_NUM_THREADS told it.
    """

    pressures_kpa: Array
    displacements: Array
    reached_kpa: float
    trouble: str
    increments: int
    iterations: int
    cpu_seconds: float
    threads: str


def run(model: Model, finger: Finger, pressures_kpa: Array, tolerance: float, timeout_s: float) -> Course:
    """Simulate `finger` in a temporary folder, observed at `pressures_kpa` (P,), the last of which is the highest.

    Raises
    ------
    LabError
        When not even the weight alone led to an equilibrium.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads())}
    weighed, law = weighs(finger), finger.material.calculix()
    before = _cpu_seconds()
    with tempfile.TemporaryDirectory(prefix="pgdl_lab_calculix_") as folder:
        job = Path(folder) / "finger"
        job.with_suffix(".inp").write_text(deck(model, finger, pressures_kpa, tolerance))
        with job.with_suffix(".log").open("w") as log:
            process = subprocess.Popen(
                [program(), "-i", job.name], cwd=folder, env=environment, stdout=log, stderr=subprocess.STDOUT
            )
        try:
            in_time = _watch(process, job.with_suffix(".sta"), 1 + weighed, float(pressures_kpa[-1]), timeout_s)
        finally:  # also when this process is interrupted
            process.kill()
            process.wait()
        told = job.with_suffix(".log").read_text(errors="replace")
        increments = read_increments(job.with_suffix(".sta"))
        states = list(read_displacements(job.with_suffix(".dat"), len(model.discretisation.positions)))
    trouble = _trouble(process.returncode, told) if in_time else f"fem.timeout_s={timeout_s:g} s were over"
    if not weighed:
        states.insert(0, np.zeros_like(model.discretisation.positions))
    if not states:
        why = " Of a law in principal stretches it has few digits at such strains." if law.principal else ""
        raise LabError(f"CalculiX found no equilibrium under the weight alone: {trouble}.{why} Choose fem=solid.")
    converged = [increment for increment in increments if increment.converged]
    return Course(
        pressures_kpa=np.array([0.0, *pressures_kpa])[: len(states)],
        displacements=np.array(states),
        reached_kpa=max((at.time_s for at in converged if at.step == 1 + weighed), default=0.0),
        trouble=trouble,
        increments=len(converged),
        iterations=sum(increment.iterations for increment in increments),
        cpu_seconds=_cpu_seconds() - before,
        threads=environment["OMP_NUM_THREADS"],
    )


def _watch(process: "subprocess.Popen[bytes]", file: Path, steps: int, max_kpa: float, timeout_s: float) -> bool:
    """Show the progress that `file` tells until the program ends; whether it did so in time."""
    deadline = time.monotonic() + timeout_s
    with progress() as show:
        while time.monotonic() < deadline:
            try:
                process.wait(GLANCE_S)
                return True
            except subprocess.TimeoutExpired:
                last = next((at for at in reversed(read_increments(file)) if at.converged), None)
            if last is not None and last.step == steps:
                show(last.time_s / max_kpa, f"{last.time_s:5.1f} of {max_kpa:g} kPa")
            elif last is not None:
                show(0.0, f"{last.time_s:4.0%} of the weight")
    return False


def read_increments(path: Path) -> list[Increment]:
    """Increments in the progress file (.sta) so far, attempts that failed included."""
    if not path.exists():
        return []
    # step, increment, attempt (with U: not converged), iterations, total time, time of the step, time of the increment
    rows = re.findall(r"^ *(\d+) +\d+ +\d+(U?) +(\d+) +\S+ +(\S+) +\S+$", path.read_text(), flags=re.MULTILINE)
    return [Increment(int(step), not failed, int(count), float(until)) for step, failed, count, until in rows]


def read_displacements(path: Path, nodes: int) -> Iterator[Array]:
    """Displacements (N, 3) [mm] of each whole table in the result file (.dat)."""
    if not path.exists():
        return
    with path.open() as file:
        for line in file:
            if line.startswith(" displacements"):
                rows = [row for row in islice(file, nodes + 1) if row.endswith("\n")][1:]  # an empty line comes first
                if len(rows) == nodes:
                    yield np.loadtxt(rows, usecols=(1, 2, 3))


def _trouble(code: int, told: str) -> str:
    """Why the program failed, from its exit `code` and its output; empty if it did not."""
    if code == 0:
        return ""
    if code < 0:
        return f"signal {-code} killed the program"
    errors = re.findall(r"\*ERROR:? *(.+)", told)
    return f"it says '{errors[-1].strip()}'" if errors else f"its exit code is {code}"


def _cpu_seconds() -> float:
    """Processor time of all child processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
