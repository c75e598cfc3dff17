"""The benchmarks: one command knows all of them, each has a quick form and a line of docs/benchmarks.md."""

import ast
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks import quick
from tests.conftest import CHECKOUT, environment

SHARED = ("common", "quick", "scenes")
BENCHMARKS = sorted(path for path in (CHECKOUT / "benchmarks").glob("*.py") if path.stem not in SHARED)


def test_the_page_has_a_line_for_every_benchmark_and_for_no_other() -> None:
    page = quick.PAGE.read_text(encoding="utf-8")
    names = [name for name, *_ in quick.ROW.findall(page)]
    assert sorted(names) == [path.stem for path in BENCHMARKS]
    for name, question, _ in quick.ROW.findall(page):
        assert question.endswith("?"), name
    assert len(names) == sum(line.startswith("| `") for line in page.splitlines()), (
        "a line that the command cannot read"
    )


@pytest.mark.parametrize("path", BENCHMARKS, ids=lambda path: path.stem)
def test_each_has_a_quick_form(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    parsed = [call for call in calls if ast.unparse(call.func).rpartition(".")[2] == "parsed"]
    assert len(parsed) == 1, "arguments are read by benchmarks.common.parsed, which knows --quick"
    asked = any(isinstance(node, ast.Attribute) and node.attr == "quick" for node in ast.walk(tree))
    assert parsed[0].keywords or asked, "--quick changes nothing"


@pytest.mark.parametrize("path", BENCHMARKS, ids=lambda path: path.stem)
def test_a_quick_run_writes_nothing_in_docs(path: Path) -> None:
    """Pages and figures go where `folders` says."""
    constants = [node.value for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
                 if isinstance(node, ast.Constant) and isinstance(node.value, str)]  # fmt: skip
    assert "docs" not in constants and not [text for text in constants if text.startswith("docs/")]


def test_quick_runs_of_the_cheapest(tmp_path: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in (CHECKOUT / "docs").rglob("*")}
    command = [sys.executable, CHECKOUT / "benchmarks" / "quick.py", "kinks", "derivatives", "newton_iteration"]
    done = subprocess.run(command, env=environment(tmp_path), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all 3 came through" in done.stdout and "How quick is one Newton iteration" in done.stdout
    assert "equilibria" in (tmp_path / "runs" / "quick" / "kinks.log").read_text(encoding="utf-8")
    assert before == {path: path.stat().st_mtime_ns for path in (CHECKOUT / "docs").rglob("*")}


def _ended(tmp_path: Path, source: str, limit_s: float = 60.0) -> quick.Outcome:
    script = tmp_path / "benchmark.py"
    script.write_text(source)
    return quick.run(script, tmp_path / "benchmark.log", limit_s)


def test_how_a_run_ended_is_told(tmp_path: Path) -> None:
    failed = _ended(tmp_path, "raise ValueError('no figure')")
    assert not failed.good and failed.said.startswith("ValueError: no figure, see ")
    skipped = _ended(tmp_path, "from benchmarks.common import skip\nskip('CalculiX', 'calculix-ccx')")
    assert skipped.good and skipped.said == "skipped: CalculiX; install calculix-ccx"
    partly = _ended(tmp_path, "from benchmarks.common import missing\nmissing('PINA', 'pina')\nprint('done')")
    assert partly.good and partly.said == "ok, without PINA; install pina"
    assert _ended(tmp_path, "print('done')").said == "ok"


def test_a_run_that_takes_too_long_ends_with_all_that_it_started(tmp_path: Path) -> None:
    sleep = "import time; time.sleep(99)"
    start = f"import subprocess, sys; child = subprocess.Popen([sys.executable, '-c', '{sleep}'])"
    late = _ended(tmp_path, f"{start}; print(child.pid, flush=True); {sleep}", limit_s=2.0)
    assert not late.good and late.said.startswith("not done in 2 s")
    status = Path(f"/proc/{int((tmp_path / 'benchmark.log').read_text())}/stat")
    until = time.monotonic() + 5  # a process that was killed takes a moment to go; one that lives sleeps for 99 s
    while _lives(status) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _lives(status)


def _lives(status: Path) -> bool:
    """Whether there is a process, by its /proc/PID/stat; one that ended may not be collected yet."""
    try:
        return status.read_text().split()[2] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_an_unknown_name_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["quick.py", "gone"])
    with pytest.raises(SystemExit):
        quick.main()
    assert "there is no benchmark gone; choose among fingers" in capsys.readouterr().err
