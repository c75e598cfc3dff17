"""What a terminal or a pipe cannot take ends no run."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import environment

SAY = """
import sys
from pgdl_lab.core import streams
streams.last()
for number in range(3000):
    print(f"{number}: 1 mm² – 2 μm ━━ ä 你好")
print("warned of µ and ²", file=sys.stderr)
sys.stdout.flush()
open(sys.argv[1], "w").write("came to its end")
"""


def say(shell: str, root: Path, **more: str) -> subprocess.CompletedProcess[bytes]:
    (root / "say.py").write_text(SAY, encoding="utf-8")
    command = shell.replace("SAY", f"'{sys.executable}' say.py end")
    variables = environment(root) | more
    return subprocess.run(["bash", "-c", command], cwd=root, env=variables, capture_output=True, check=False)


@pytest.mark.parametrize("encoding", ["gbk", "ascii", "cp1252", "latin-1:strict"])
def test_letters_that_an_encoding_lacks_are_let_go(encoding: str, tmp_path: Path) -> None:
    done = say("SAY > log.txt", tmp_path, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr.count(b"\n")) == (0, 1)
    assert (tmp_path / "end").exists()
    assert (tmp_path / "log.txt").read_bytes().count(b" mm") == 3000


@pytest.mark.parametrize(
    "shell",
    ["SAY | head -n 1", "SAY 2>&1 | head -n 1", "SAY > /dev/full", "SAY >&-", "SAY 2>&-", "SAY >&- 2>&-"],
)
def test_an_output_that_nobody_reads_ends_nothing(shell: str, tmp_path: Path) -> None:
    done = say(f"set -o pipefail; {shell}", tmp_path)
    assert done.returncode == 0
    assert done.stderr in (b"", "warned of µ and ²\n".encode())
    assert (tmp_path / "end").exists()


def test_help_is_cut_off_without_a_word(tmp_path: Path) -> None:
    command = f"set -o pipefail; '{sys.executable}' -m pgdl_lab --help | head -n 1"
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, env=environment(tmp_path), capture_output=True)
    assert (done.returncode, done.stderr, done.stdout.count(b"\n")) == (0, b"", 1)
