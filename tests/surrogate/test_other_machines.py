"""Files from one machine on another: those in stored/ were written elsewhere, with the answers that they gave there.

`python -m tests.surrogate.test_other_machines` writes them anew, which only another version of the format calls for.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import pgdl_lab
from pgdl_lab.export import numpy_form
from tests.conftest import CHECKOUT

STORED = Path(__file__).with_name("stored")
KPA = [0.3, 17.7, 49.9]
PLAIN, TRAINED, NETWORK = "modes.npz", "modes.pt", "network.npz"
SCRIPT = f"""
import sys
import numpy as np
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
import pgdl_lab
print([name for name in __cpu_dispatch__ if __cpu_features__[name]])
print(pgdl_lab.load(sys.argv[1]).predict(np.load(sys.argv[2]), {KPA}).tobytes().hex())
"""


def write() -> None:
    """Train two small surrogates, and store them with what they answer."""
    from tests.test_surrogate import trained

    with tempfile.TemporaryDirectory() as folder:
        modes, network = (trained(name, Path(folder)) for name in ("pod", "mlp"))
    STORED.mkdir(exist_ok=True)
    modes.save(STORED / TRAINED)
    numpy_form.write(modes, STORED / PLAIN)
    numpy_form.write(network, STORED / NETWORK)
    mesh, rng = modes.domain.mesh, np.random.default_rng(0)
    corners = mesh.points_mm[mesh.simplices[rng.integers(len(mesh.simplices), size=200)]]
    points = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), 200), corners)
    np.save(STORED / "points_mm.npy", points)
    for name in (PLAIN, NETWORK):
        answers = pgdl_lab.load(STORED / name).predict(points, KPA)
        np.save(STORED / f"{Path(name).stem}_mm.npy", answers)


@pytest.mark.parametrize(("name", "tolerance_mm"), [(PLAIN, 0), (TRAINED, 1e-11), (NETWORK, 1e-9)])
def test_a_stored_file_gives_the_stored_answers(name: str, tolerance_mm: float) -> None:
    answers = np.load(STORED / f"{Path(name).stem}_mm.npy")
    found = pgdl_lab.load(STORED / name).predict(np.load(STORED / "points_mm.npy"), KPA)
    assert np.abs(found - answers).max() <= tolerance_mm


def test_an_older_processor_gives_the_same_bits() -> None:
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    newer = [name for name in __cpu_dispatch__ if __cpu_features__[name]]
    if not newer:
        pytest.skip("this processor is the oldest that NumPy knows")
    found = {}
    for settings in ({}, {"NPY_DISABLE_CPU_FEATURES": " ".join(newer), "OPENBLAS_CORETYPE": "Prescott"}):
        environment = {**os.environ, "PYTHONPATH": str(CHECKOUT), **settings}
        command = [sys.executable, "-c", SCRIPT, str(STORED / PLAIN), str(STORED / "points_mm.npy")]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        features, answers = done.stdout.split("\n")[:2]
        found[features] = answers
    assert len(found) == 2 and "[]" in found, "the second process did not do without the newer instructions"
    assert set(found.values()) == {np.load(STORED / "modes_mm.npy").tobytes().hex()}


if __name__ == "__main__":
    write()
