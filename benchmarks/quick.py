"""All benchmarks in their quick form, one after the other, and a table of how they ended.

    python benchmarks/quick.py [name ...] [--limit 300]

Each runs in a process of its own, for at most so many seconds; what it printed lies in runs/quick/NAME.log. The status
is 1 if one failed. Its times say nothing of what it measures. What there is, and the question that it answers, is read
from docs/benchmarks.md.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(CHECKOUT))  # also without an installation

from benchmarks.common import LEFT_OUT, SKIPPED, show, table  # noqa: E402
from pgdl_lab.core import paths  # noqa: E402

PAGE = CHECKOUT / "docs" / "benchmarks.md"
ROW = re.compile(r"^\| `(\w+)` \| ([^|]+) \| `python benchmarks/\1\.py([^`|]*)` \| [^|]+ \|$", re.MULTILINE)
"""A benchmark's line of the page: name, question, command and place of its numbers."""
STOPS_IN_S = 10.0


@dataclass(frozen=True)
class Outcome:
    """How a benchmark ended: the time it took [s], whether that is well, and what is said of it."""

    seconds: float
    good: bool
    said: str


def questions() -> dict[str, str]:
    """What each benchmark answers, by its name, as the page says."""
    return {name: question for name, question, _ in ROW.findall(PAGE.read_text(encoding="utf-8"))}


def run(script: Path, log: Path, limit_s: float) -> Outcome:
    """Run `script --quick`, and everything that it starts, for at most `limit_s` seconds."""
    known = os.pathsep.join(filter(None, [str(CHECKOUT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": known, "PYTHONWARNINGS": "ignore"}
    log.parent.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with log.open("w", encoding="utf-8") as output:
        process = subprocess.Popen(
            [sys.executable, script, "--quick"], stdout=output, stderr=subprocess.STDOUT, cwd=CHECKOUT,
            env=environment, start_new_session=True,
        )  # fmt: skip
        try:
            status = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            stop(process)
            return Outcome(time.monotonic() - began, False, f"not done in {limit_s:g} s, see {log}")
        except BaseException:  # Ctrl+C too: nothing that was started here stays behind
            stop(process)
            raise
    seconds, lines = time.monotonic() - began, log.read_text(encoding="utf-8").splitlines()
    without = "; ".join(line.removeprefix(LEFT_OUT) for line in lines if line.startswith(LEFT_OUT))
    if status == SKIPPED:
        return Outcome(seconds, True, f"skipped: {without}")
    if status:
        return Outcome(seconds, False, f"{lines[-1] if lines else f'status {status}'}, see {log}")
    return Outcome(seconds, True, f"ok, without {without}" if without else "ok")


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a process and all that it started, kindly at first: a server of its own ends with it."""
    for kind in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, kind)
            process.wait(STOPS_IN_S)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            continue


def main() -> None:
    """Run them and print the table."""
    known = questions()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="name", help="default: all")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds for each")
    given = parser.parse_args()
    if unknown := [name for name in given.names if name not in known]:
        parser.error(f"there is no benchmark {', '.join(unknown)}; choose among {', '.join(known)}")
    outcomes = {}
    for name in given.names or known:
        print(f"{name} … ", end="", flush=True)
        outcomes[name] = run(Path(__file__).with_name(f"{name}.py"), paths.RUNS / "quick" / f"{name}.log", given.limit)
        print(f"{outcomes[name].seconds:.0f} s, {outcomes[name].said}", flush=True)
    shown = table("Quick runs", ("benchmark", "what it answers", "seconds", "how it ended"), left=2)
    shown.columns[3].justify = "left"
    for name, outcome in outcomes.items():
        shown.add_row(name, known[name], f"{outcome.seconds:.0f}", outcome.said)
    show(shown)
    failed = [name for name, outcome in outcomes.items() if not outcome.good]
    if failed:
        sys.exit(f"{len(failed)} of {len(outcomes)} failed: {', '.join(failed)}")
    print(f"all {len(outcomes)} came through in {sum(outcome.seconds for outcome in outcomes.values()):.0f} s")


if __name__ == "__main__":
    main()
