"""The examples run and say what they are for."""

import shutil
import subprocess
import sys

import pytest

from tests.conftest import CHECKOUT, environment


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("first_surrogate", "the tip is as low as it is there at 12.5 kPa"),
        ("compare_models", "Hybrid"),
        ("beyond_the_data", "At 100 kPa: 100 kPa lies too far outside the trained 1 to 24 kPa"),
        ("own_mesh", "At 10 kPa the tip is at x = 45."),
        ("own_model", "lines: "),
        ("several_inputs", "12 kPa reaches the target"),
        ("whole_body", "the chamber holds 1562 mm³ at rest"),
    ],
)
def test_examples_run(name: str, told: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    root = tmp_path_factory.getbasetemp() / "examples"  # one place, so that they share a simulation
    root.mkdir(exist_ok=True)
    file = shutil.copy(CHECKOUT / "examples" / f"{name}.py", root)
    shutil.copy(CHECKOUT / "examples" / "finger.msh", root)
    ran = subprocess.run(
        [sys.executable, file], cwd=root, env=environment(root), capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert told in ran.stdout, ran.stdout
    assert "Warning" not in ran.stderr, ran.stderr
