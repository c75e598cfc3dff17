"""Surrogate files made to harm: no code of them or named by them runs, and they take no more memory than they are."""

import copy
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from pgdl_lab.surrogate import archive
from tests.conftest import CHECKOUT
from tests.surrogate.test_other_machines import STORED
from tests.test_surrogate import trained
from tests.test_surrogate_file import Malicious

LOADED = """
import json, re, resource, sys
import pgdl_lab
from omegaconf import OmegaConf
from pgdl_lab.core.errors import InputError
OmegaConf.register_new_resolver("run", lambda: open(sys.argv[1] + "/ran", "w") and "silu")
for whole in sys.argv[2:5]:
    pgdl_lab.load(whole)  # with all that this imports
pages = int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 100_000_000,) * 2)
def resident_kb(which):
    return int(re.search(rf"{which}:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
with open("/proc/self/clear_refs", "w") as peak:
    peak.write("5")  # the highest is counted from here on
before = resident_kb("VmRSS")
told = {}
for path in sys.argv[5:]:
    try:
        pgdl_lab.load(path)
    except InputError as refused:
        told[path] = str(refused)
print(json.dumps([told, resident_kb("VmHWM") - before]))
"""
SPREAD = 10**7  # edges apart


def header(entries: dict[str, Any]) -> bytes:
    text = json.dumps(entries).encode()
    return len(text).to_bytes(8, "little") + text


def npy(shape: str, descr: str = "<f8", numbers: bytes = bytes(8)) -> bytes:
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + numbers


def zipped(path: Path, entry: bytes, how: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", how) as file:
        file.writestr("about.npy", npy("()", "<U2", "{}".encode("utf-32-le")))
        file.writestr("state/modes.npy", entry)


def repeated(path: Path) -> None:
    """One entry under many names."""
    zipped(path, npy("(100000,)", numbers=bytes(800_000)))
    with zipfile.ZipFile(path, "a") as file:
        for number in range(1000):
            other = copy.copy(file.filelist[1])
            other.filename = f"state/{number}.npy"
            file.filelist.append(other)
        file._didModify = True


def changed(path: Path, whole: Path, model: dict[str, Any], **entries: NDArray[Any]) -> None:
    """The surrogate `whole`, with other settings of its model and other arrays of its state."""
    content = archive.read(whole)
    state, face = content.pop("state"), content.pop("face")
    archive.write(path, {**content, "model": {**content["model"], **model}}, state={**state, **entries}, face=face)


def scattered(path: Path, whole: Path) -> None:
    """The face is of as many triangles as before, far from each other."""
    content = archive.read(whole)
    state, face = content.pop("state"), content.pop("face")
    corners = face["points_mm"][face["triangles"][0]]
    places = SPREAD * np.arange(len(face["triangles"]))[:, None, None] * np.ptp(corners, axis=0)
    triangles = np.arange(3 * len(face["triangles"])).reshape(-1, 3)
    face = {"points_mm": (corners + places).reshape(-1, 2), "triangles": triangles, "base": face["base"]}
    archive.write(path, content, state=state, face=face)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files of surrogates as they should be."""
    folder = tmp_path_factory.mktemp("whole")
    paths = {name: folder / f"{name}.pt" for name in ("mlp", "gaussian_process")}
    for name, path in paths.items():
        trained(name, folder).save(path)
    return {**paths, "pod": STORED / "modes.pt"}


def hostile_files(folder: Path, whole: dict[str, Path]) -> dict[Path, str]:
    """Files, with what their refusal must say."""
    told = {}

    def new(name: str, *words: str) -> Path:
        told[folder / name] = rf"^\S*/{name} .*{'.*'.join(words)}.*\.$"
        return folder / name

    about = {"__metadata__": {"about": "{}", "sha256": ""}}
    entry = {"dtype": "F64", "data_offsets": [0, 8]}
    new("shape.pt", "'state/a' is said to be 40000 × 40000 numbers", "there are 1.. bytes").write_bytes(
        header({**about, "state/a": {**entry, "shape": [40000, 40000]}}) + bytes(8)
    )
    new("twice.pt", "invalid offset").write_bytes(
        header({**about, **{f"state/{name}": {**entry, "shape": [1]} for name in "abc"}}) + bytes(8)
    )
    new("header.pt", "4,611,686,018,427,387,904 bytes, and the file has 10").write_bytes(
        (2**62).to_bytes(8, "little") + b"{}"
    )
    torch.save({"state": torch.zeros(1).expand(400_000_000)}, new("stride.pt", "by an earlier pgdl_lab as a pickle"))
    torch.save(Malicious(folder), new("pickle.pt", "by an earlier pgdl_lab as a pickle"))
    zipped(new("shape.npz", r"'state/modes' is said to be 1000000000 numbers of 8 bytes", "there are 8 bytes"),
           npy("(1000000000,)"))  # fmt: skip
    zipped(new("bomb.npz", r"take 200,\d+,\d+ bytes unpacked, and the file has \d..,\d+"),
           npy("(25000000,)", numbers=bytes(200_000_000)), zipfile.ZIP_DEFLATED)  # fmt: skip
    zipped(new("objects.npz", "'state/modes' holds objects"), npy("()", "|O", pickle.dumps(Malicious(folder))))
    repeated(new("repeated.npz", r"bytes unpacked, and the file has"))
    changed(new("width.pt", "does not hold the weights"), whole["mlp"], {"width": 15 * 10**5})
    changed(new("depth.pt", "model.depth is 1000000000, and there are 8 arrays"), whole["mlp"], {"depth": 10**9})
    changed(
        new("text.pt", r"holds the setting '\$\{run:\}': stored settings are values"),
        whole["mlp"],
        {"activation": "${run:}"},
    )
    scattered(new("table.pt", r"its mesh would take \d[\d,]+ entries, and 1,048,576 are"), whole["pod"])
    changed(new("points.pt", "learnt from 20,000 points, and 5,000 are allowed"), whole["gaussian_process"], {},
            inputs=np.zeros((20000, 17)), weights_mm=np.zeros((20000, 2)))  # fmt: skip
    return told


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for the memory of a process")
def test_no_file_takes_more_memory_than_it_is_or_runs_code(whole: dict[str, Path], tmp_path: Path) -> None:
    expected = hostile_files(tmp_path, whole)
    command = [sys.executable, "-c", LOADED, *map(str, [tmp_path, *whole.values(), *expected])]
    environment = {**os.environ, "PYTHONPATH": str(CHECKOUT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told, more_kb = json.loads(done.stdout)
    for path, words in expected.items():
        assert str(path) in told, f"{path.name} is loaded"
        assert re.search(words, told[str(path)]), told[str(path)]
    assert more_kb < 20_000
    assert not (tmp_path / "ran").exists()


OWN = """
from dataclasses import dataclass
from pathlib import Path
from pgdl_lab.plugins.model.pod import Pod
from pgdl_lab.core.registry import register
Path("ran").touch()

@register("model", "own")
@dataclass(frozen=True)
class Own(Pod):
    pass
"""


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """Environment in which the package is found as a wheel installs it, with plugins of others in `tmp_path`/home."""
    site, home = tmp_path / "site", tmp_path / "home"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(CHECKOUT / "pgdl_lab", site / "pgdl_lab", ignore=ignored)
    for kind in ("model", "fem"):
        shutil.copytree(CHECKOUT / "plugins" / kind, site / "pgdl_lab" / "plugins" / kind, ignore=ignored)
    (home / "plugins" / "model").mkdir(parents=True)
    (home / "plugins" / "model" / "own.py").write_text(OWN)
    package = home / "other-1.0.dist-info"  # Python looks for these in the working directory too
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[pgdl_lab.plugins]\nother = other\n")
    (home / "other.py").write_text("open('ran', 'w')")
    environment = {**os.environ, "PYTHONPATH": str(site)}
    environment.pop("PGDL_LAB_ROOT")
    return environment


def python(script: str, path: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", script, str(path)]
    home = path.parent / "home"
    return subprocess.run(command, env=environment, cwd=home, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("first", ["", "raise SystemExit('a package of others ran')"])
def test_a_wheel_loads_no_plugin_of_the_working_directory(
    first: str, installed: dict[str, str], whole: dict[str, Path], tmp_path: Path
) -> None:
    if first:
        (tmp_path / "home" / "plugins" / "model" / "__init__.py").write_text(first)
    for name in ("mlp", "oracle"):
        changed(tmp_path / f"{name}.pt", whole["mlp"], {"name": name})
    done = python("import sys, pgdl_lab; print(pgdl_lab.load(sys.argv[1]).model)", tmp_path / "mlp.pt", installed)
    assert done.returncode == 0 and "'name': 'mlp'" in done.stdout, done.stderr
    done = python("import sys, pgdl_lab; pgdl_lab.load(sys.argv[1])", tmp_path / "oracle.pt", installed)
    assert "the model 'oracle', which pgdl_lab does not ship" in done.stderr
    assert not (tmp_path / "home" / "ran").exists()


def test_plugins_that_are_asked_for_load_also_in_processes(
    installed: dict[str, str], whole: dict[str, Path], tmp_path: Path
) -> None:
    changed(tmp_path / "own.pt", whole["pod"], {"name": "own"})
    script = "import sys, pgdl_lab; pgdl_lab.load(sys.argv[1])"
    refused = python(script, tmp_path / "own.pt", installed)
    home = tmp_path / "home"
    assert not (home / "ran").exists()
    assert f"pgdl_lab.discover() before, which imports those in {home}/plugins" in refused.stderr
    asked = (
        "import pickle, subprocess, sys, pgdl_lab; from pgdl_lab.core.registry import discover, plugin; discover()\n"
        "pgdl_lab.load(sys.argv[1])\n"
        'again = f\'import pickle; print(pickle.loads({pickle.dumps(plugin("model", "own")())!r}))\'\n'
        "subprocess.run([sys.executable, '-c', again], check=True)"
    )
    done = python(asked, tmp_path / "own.pt", installed)
    assert done.returncode == 0 and done.stdout.startswith("Own("), done.stderr
    assert (home / "ran").exists()
