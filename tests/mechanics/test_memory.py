"""What a simulation needs in memory is known before it begins, and said where there is not enough."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from skfem import MeshHex

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics import memory
from pgdl_lab.mechanics.discretisation_error import refined
from pgdl_lab.mechanics.elements import ELEMENTS, discretise
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.memory import Size, TooLarge
from tests.fingers import OBSERVATION, pneunet, solid, tetrahedra

MEASURED = r"""
import re, numpy as np
from pathlib import Path
from pgdl_lab.mechanics.finite_strain import Model
from tests.fingers import pneunet
model = Model(pneunet(chambers=2), 2.5, "hex27_p1", "auto")
rest = np.zeros_like(model.discretisation.positions)
for _ in range(2):
    model.solver.factorise(model.equilibrium.balance(rest, model.amplitudes(0.0), stiffness=True).stiffness)
print(1024 * int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1]))
"""


@pytest.mark.parametrize("element", list(ELEMENTS))
def test_size_of_a_mesh_and_of_its_refinement(element: str) -> None:
    mesh, kind = pneunet().mesh(6.0), ELEMENTS[element]
    if kind.cells == "tetrahedra":
        mesh = tetrahedra(mesh)
    assert Size.of(mesh).unknowns(kind) == discretise(mesh, kind).positions.size
    assert Size.of(mesh).refined() == Size.of(refined(mesh))


@pytest.mark.skipif(sys.platform != "linux", reason="the largest memory of a process is told elsewhere")
def test_estimate_is_near_what_is_used() -> None:
    used = float(subprocess.run([sys.executable, "-c", MEASURED], capture_output=True, text=True, check=True).stdout)
    estimate = Size.of(pneunet(chambers=2).mesh(2.5)).needed(ELEMENTS["hex27_p1"])
    assert estimate == pytest.approx(used, rel=0.3)


def test_a_mesh_that_does_not_fit_is_refused_with_one_that_does(monkeypatch: pytest.MonkeyPatch) -> None:
    finger, kind = pneunet(), ELEMENTS["hex20"]
    needed = Size.of(finger.mesh(1.5)).needed(kind)
    monkeypatch.setattr(memory, "available", lambda: needed - 1)
    sentence = r"fem.edge_mm=1.5 has [\d,]+ elements with [\d,]+ unknowns: .* GB of memory, and .* GB are free; choose"
    with pytest.raises(InputError, match=sentence) as told:
        Model(finger, 1.5, "hex20")
    found = re.search(r"choose fem.edge_mm=([\d.]+) or close", str(told.value))
    assert found is not None
    Model(finger, float(found[1]), "hex20")
    monkeypatch.setattr(memory, "available", lambda: needed + 1)
    Model(finger, 1.5, "hex20")


def test_an_estimate_that_does_not_fit_is_refused_before_the_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    size, kind = Size.of(pneunet().mesh(6.0)), ELEMENTS["hex20"]
    monkeypatch.setattr(memory, "available", lambda: (size.needed(kind) + size.refined().needed(kind)) / 2)
    monkeypatch.setattr(Model, "load", lambda *_: pytest.fail("it had begun"))
    with pytest.raises(InputError, match="refined to estimate its error, has .*; .*set fem.estimate_error=false"):
        solid(estimate_error=True).simulate(pneunet(), OBSERVATION)
    with pytest.raises(pytest.fail.Exception, match="it had begun"):
        solid(estimate_error=False).simulate(pneunet(), OBSERVATION)


@pytest.mark.parametrize(
    ("files", "free"),
    [
        ({"memory.max": "max"}, np.inf),
        ({"memory.max": "9000"}, 9000 - 4000 + 500),
        ({"memory/memory.limit_in_bytes": "6000"}, 6000 - 4000 + 700),
        ({}, np.inf),
    ],
)
def test_limit_of_a_container(files: dict[str, str], free: float, tmp_path: Path) -> None:
    for name, limit in files.items():
        folder = (tmp_path / name).parent
        folder.mkdir(exist_ok=True)
        (tmp_path / name).write_text(f"{limit}\n")
        (folder / "memory.current").write_text("4000\n")
        (folder / "memory.usage_in_bytes").write_text("4000\n")
        (folder / "memory.stat").write_text("anon 3000\ninactive_file 500\ntotal_inactive_file 700\n")
    assert memory._of_group(tmp_path) == free


def test_memory_of_this_machine_is_known() -> None:
    assert 1e8 < memory.available() < 1e14


def test_what_is_needed_is_said_in_gigabytes_and_nothing_that_does_not_help_is_advised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One element of 60 unknowns: the program's own 0.1 GB, 135 kB to assemble and 55 kB of factors."""
    one = MeshHex()
    kind = ELEMENTS["hex20"]
    assert Size.of(one).needed(kind) == pytest.approx(1e8 + 8 * 4.7 * 60**2 + 330 * 60**1.25, rel=1e-12)
    monkeypatch.setattr(memory, "available", lambda: 5e7)
    tried: list[float] = []

    def remesh(edge_mm: float) -> MeshHex:
        tried.append(edge_mm)
        return one

    with pytest.raises(TooLarge) as told:
        memory.require(one, kind, 2.0, remesh, refined=False)
    assert str(told.value) == (
        "The mesh of fem.edge_mm=2 has 1 elements with 60 unknowns: they take some 0.1 GB of memory, and 0.05 GB are "
        "free; mesh the body with fewer elements or close other programs."
    )
    # each edge is a tenth longer than the one before
    np.testing.assert_allclose(np.diff(np.log([2.0, *tried])), np.log(1.1), rtol=1e-9)
    monkeypatch.setattr(memory, "available", lambda: Size.of(one).needed(kind))
    memory.require(one, kind, 2.0, remesh, refined=False)  # just enough


@pytest.mark.skipif(sys.platform != "linux", reason="memory is told elsewhere")
def test_memory_of_this_machine_is_that_of_another_look_at_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """As /proc says, in kB; where that tells nothing, all that the machine has is taken."""
    said = Path("/proc/meminfo").read_text()
    total, left = (1024 * int(re.findall(rf"{name}:\s+(\d+) kB", said)[0]) for name in ("MemTotal", "MemAvailable"))
    assert memory._of_machine() == pytest.approx(left, rel=0.3)
    monkeypatch.setattr(Path, "read_text", lambda _: "MemTotal: 1 kB\n")
    assert memory._of_machine() == pytest.approx(total, rel=0.05)
