"""What results come from is found whole: an edit anywhere in it, or another version of it, is another result."""

import ast
import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree

import pytest

from pgdl_lab.core import sources
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.running.cache import snapshot_path
from tests.conftest import CHECKOUT, environment
from tests.fingers import OBSERVATION, pneunet, solid

MINE = '''
from dataclasses import dataclass
from pgdl_lab.plugins.finger.pneunet import Pneunet
from pgdl_lab.core.registry import register

@register("finger", "mine")
@dataclass(frozen=True)
class Mine(Pneunet):
    """A finger of a user."""
'''
EDIT = """
import json, sys
from pathlib import Path
from pgdl_lab.core import registry, sources
from pgdl_lab.running import cache
from pgdl_lab.core.observation import Observation
registry.discover()
root = Path(sources.__file__).parents[2]

def keys():
    sources._read.clear()  # as in another process
    finger = registry.plugin("finger", "mine")()
    return [cache.snapshot_path(Path(), finger, registry.plugin("fem", fem)(), Observation()).stem
            for fem in ("solid", "rod")]

before, found = keys(), {}
for file in sys.argv[1:]:
    path = root / file
    content = path.read_bytes()
    path.write_bytes(content + b"# edited\\n")
    found[file] = [now != then for now, then in zip(keys(), before)]
    path.write_bytes(content)
assert keys() == before
print(json.dumps(found))
"""
BOTH = (
    "pgdl_lab/mechanics/finger.py",
    "pgdl_lab/mechanics/fem.py",
    "pgdl_lab/core/dataset.py",
    "pgdl_lab/mechanics/material.py",
    "pgdl_lab/mechanics/extrude.py",  # imported when a mesh is asked for
    "plugins/finger/mine.py",
    "plugins/finger/pneunet.py",
)
ROD, SOLID = ("plugins/fem/rod.py", "pgdl_lab/mechanics/segments.py"), ("plugins/fem/solid.py",)
NEITHER = (
    "pgdl_lab/mechanics/calculix.py",
    "pgdl_lab/learning/module.py",
    "pgdl_lab/surrogate/surrogate.py",
    "plugins/fem/section.py",
    "plugins/finger/joints.py",
)


@pytest.fixture(scope="module")
def edited(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[bool]]:
    """By file: whether an edit of it changes where snapshots of `fem=solid` and of `fem=rod` lie."""
    root = tmp_path_factory.mktemp("lab")
    for folder in ("pgdl_lab", "plugins", "conf"):
        copytree(CHECKOUT / folder, root / folder, ignore=lambda *_: ["__pycache__"])
    (root / "pyproject.toml").touch()
    (root / "plugins" / "finger" / "mine.py").write_text(MINE)
    command = [sys.executable, "-c", EDIT, *BOTH, *ROD, *SOLID, *NEITHER]
    known = environment(root) | {"PYTHONPATH": str(root)}
    done = subprocess.run(command, env=known, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("file", BOTH)
def test_an_edit_of_what_finger_and_solver_reach_is_another_simulation(
    edited: dict[str, list[bool]], file: str
) -> None:
    assert edited[file] == [True, True]


@pytest.mark.parametrize("file", [*ROD, *SOLID, *NEITHER])
def test_an_edit_of_other_code_leaves_simulations_where_they_are(edited: dict[str, list[bool]], file: str) -> None:
    assert edited[file] == [file in SOLID, file in ROD]


def path_of(finger: Finger, fem: Fem) -> Path:
    return snapshot_path(Path(), finger, fem, OBSERVATION)


@pytest.mark.parametrize("library", ["numpy", "scipy", "scikit-fem", "pypardiso", "mkl", "ipctk"])
def test_another_version_of_a_library_that_solves_is_another_simulation(
    library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = path_of(pneunet(), solid())
    original = sources._versions

    def upgraded(found: sources.Distribution) -> dict[str, str]:
        return {name: "999" if name == library else version for name, version in original(found).items()}

    monkeypatch.setattr(sources, "_versions", upgraded)
    assert path_of(pneunet(), solid()) != before


def test_libraries_that_compute_nothing_do_not_count() -> None:
    _, libraries = sources.reached([type(solid()), type(pneunet())])
    assert "numpy" in libraries and not {"rich", "h5py", "omegaconf", "torch", "mlflow"} & libraries.keys()


def test_imports_are_those_that_the_grammar_finds() -> None:
    """By the parser of Python, on all files here: a statement that was missed would be an edit that is missed."""
    files = [path for folder in ("pgdl_lab", "plugins", "tests") for path in (CHECKOUT / folder).rglob("*.py")]
    assert len(files) > 100
    for path in files:
        content = path.read_bytes()
        everything = [node for node in ast.walk(ast.parse(content)) if isinstance(node, ast.Import | ast.ImportFrom)]
        dumped = {ast.dump(node) for node in everything}
        assert dumped <= {ast.dump(node) for node in sources._imports(content, everywhere=True)}, path
        top = {ast.dump(node) for node in ast.parse(content).body if isinstance(node, ast.Import | ast.ImportFrom)}
        assert top <= {ast.dump(node) for node in sources._imports(content, everywhere=False)}, path


@pytest.fixture
def helper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package of a user that pip knows nothing of."""
    folder = tmp_path / "my_lab"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "fingers.py").write_text("from . import walls\nfrom .walls import THICK\nclass Stout:\n    pass\n")
    (folder / "walls.py").write_text("THICK = 3.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "my_lab"]:
        del sys.modules[name]


def test_relative_imports_and_files_outside_packages_count(helper: Path) -> None:
    stout = importlib.import_module("my_lab.fingers").Stout
    code, _ = sources.reached([stout])
    assert {"my_lab", "my_lab.fingers", "my_lab.walls"} == {name for name in code if name.startswith("my_lab")}


def test_a_file_that_is_edited_while_it_runs_is_not_what_runs(helper: Path) -> None:
    fingers = importlib.import_module("my_lab.fingers")
    before = sources.digest([fingers.Stout])
    (helper / "fingers.py").write_text("class Stout:\n    width = 20\n")
    assert sources.digest([fingers.Stout]) == before
    importlib.reload(fingers)
    assert sources.digest([fingers.Stout]) != before


def test_a_class_without_a_file_is_never_taken_for_another() -> None:
    typed = {"__name__": "__nowhere__"}
    exec("class Typed:\n    pass", typed)  # as at the prompt of Python
    assert sources.digest([typed["Typed"]]) != sources.digest([typed["Typed"]])
