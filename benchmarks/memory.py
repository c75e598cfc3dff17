"""The memory that a simulation takes beside what is said before it begins.

    python benchmarks/memory.py [--large]

For each mesh a process of its own makes the model and factorises its stiffness twice; for an estimate of the
discretisation error it settles on the refined mesh as well. Its largest resident memory is set against
`pgdl_lab.mechanics.memory`. With `--large` also meshes that need up to 14 GB and half an hour.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.common import parsed, parser, show, table
from pgdl_lab.core import registry
from pgdl_lab.mechanics.discretisation_error import estimate, refined
from pgdl_lab.mechanics.elements import ELEMENTS
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.memory import GB, Size

# Finger, longest edge [mm], element, whether the discretisation error is estimated.
SCENES = [
    ("pneunet", 6.0, "hex27_p1", False),
    ("pneunet", 3.0, "hex27_p1", False),
    ("pneunet", 1.5, "hex27_p1", False),
    ("pneunet", 1.5, "hex20", False),
    ("joints", 3.0, "hex27_p1", False),
    ("bellows", 3.0, "hex27_p1", False),
    ("pneunet", 6.0, "hex27_p1", True),
]
LARGE = [
    ("joints", 1.5, "hex27_p1", False),
    ("bellows", 1.5, "hex27_p1", False),
    ("pneunet", 3.0, "hex27_p1", True),
    ("bellows", 3.0, "hex27_p1", True),
    ("pneunet", 2.0, "hex27_p1", True),
]


def made(name: str) -> Finger:
    """The finger of that name, as it is."""
    registry.discover()
    finger: Finger = registry.plugin("finger", name)()
    return finger


def work(name: str, edge_mm: float, element: str, with_estimate: bool) -> None:
    """Do what takes most memory, and print the most that was held [bytes]."""
    model = Model(made(name), edge_mm, element, "auto")
    equilibrium, rest = model.equilibrium, np.zeros_like(model.discretisation.positions)
    for _ in range(2):
        model.solver.factorise(equilibrium.balance(rest, model.amplitudes(0.0), stiffness=True).stiffness)
    model.solver.close()
    if with_estimate:
        fine = model.equilibrium_on(refined(model.mesh))
        estimate(equilibrium, fine, rest, 0.0, model.amplitudes(0.0))
    # of this program alone: what getrusage tells begins with the memory of the process that started it
    status = Path("/proc/self/status").read_text()
    print(1024 * int(status.partition("VmHWM:")[2].split()[0]))


def main() -> None:
    """Measure each scene in a process of its own."""
    arguments = parser(__doc__)
    arguments.add_argument("--large", action="store_true", help="also meshes of several GB")
    given = parsed(arguments)
    headings = ("finger", "edge mm", "element", "estimate", "unknowns", "said GB", "used GB", "said / used")
    shown = table("", headings, left=len(headings))
    for name, edge_mm, element, with_estimate in SCENES[:1] if given.quick else SCENES + LARGE * given.large:
        size, kind = Size.of(made(name).mesh(edge_mm)), ELEMENTS[element]
        size = size.refined() if with_estimate else size
        scene = (name, edge_mm, element, with_estimate)
        command = [sys.executable, "-c", f"from benchmarks.memory import work; work{scene}"]
        used = float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        said = size.needed(kind)
        figures = [f"{size.unknowns(kind):,}", f"{said / GB:.2f}", f"{used / GB:.2f}", f"{said / used:.2f}"]
        shown.add_row(*map(str, scene), *figures)
    show(shown)


if __name__ == "__main__":
    main()
