"""Task `verify`: benchmarks of the mechanics beside their references, as a table and as files."""

import csv
import json
import logging
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.studies.verification import discover
from pgdl_lab.studies.verification.benchmark import BENCHMARKS, Row
from pgdl_lab.studies.verification.benchmark import run as checks
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)

COLUMNS = ("benchmark", "check", "reference", "obtained", "tolerance", "passed", "seconds", "source", "problem")


def run(job: Job) -> None:
    """Make all checks, or the quick ones, and write verify.json, verify.csv and, to be read, verify.md.

    Raises
    ------
    InputError
        When `quick` is neither true nor false.
    LabError
        When a check does not pass.
    """
    quick = job.config.quick
    if not isinstance(quick, bool):
        raise InputError(f"quick is {quick!r}; it must be true or false.")
    discover()
    rows = []
    for row in checks([each for each in BENCHMARKS if each.quick or not quick], quick):
        rows.append(row)
        _log.info("%s: %s, %.1f s", _title(row), "passed" if row.passed else "FAILED", row.seconds)
        _write(job.folder, rows)
    Console().print(_table(rows))
    _log.info("Everything is in %s", job.folder)
    failed = [_title(row) for row in rows if not row.passed]
    if failed:
        raise LabError(
            f"{len(failed)} of {len(rows)} checks failed ({'; '.join(failed)}): see {job.folder / 'verify.csv'}."
        )


def _title(row: Row) -> str:
    return f"{row.benchmark}, {row.check.name}" if row.check else f"{row.benchmark}, {row.problem}"


def _record(row: Row) -> dict[str, Any]:
    """The row under the names in `COLUMNS`."""
    figures = asdict(row.check) if row.check else {}
    return {column: None for column in COLUMNS} | {
        "benchmark": row.benchmark, "check": figures.pop("name", None), **figures,
        "passed": row.passed, "seconds": round(row.seconds, 2), "problem": row.problem,
    }  # fmt: skip


def _write(folder: Path, rows: list[Row]) -> None:
    records = [_record(row) for row in rows]
    with replacing(folder / "verify.json") as temporary:
        temporary.write_text(json.dumps(records, indent=1, ensure_ascii=False), encoding="utf-8")
    with replacing(folder / "verify.csv") as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(records)
    with replacing(folder / "verify.md") as temporary:
        temporary.write_text(_page(rows), encoding="utf-8")


def _page(rows: list[Row]) -> str:
    """All rows in Markdown."""
    passed, seconds = sum(row.passed for row in rows), sum(row.seconds for row in rows)
    lines = [
        "# Verification of the mechanics",
        "",
        f"{passed} of {len(rows)} checks passed, in {seconds:.0f} s. A check passes where what was obtained differs "
        "from its reference by the tolerance at most.",
    ]
    for name, group in groupby(rows, key=lambda row: row.benchmark):
        lines += ["", f"## {name}", "", "| check | reference | obtained | tolerance | passed | source |"]
        lines += ["| --- | --- | --- | --- | --- | --- |"]
        for row in group:
            figures, verdict = _figures(row), "yes" if row.passed else "**NO**"
            told = (row.check.name, row.check.source) if row.check else (row.problem, "")
            cells = (told[0], *figures, verdict, told[1])
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"


def _figures(row: Row) -> tuple[str, str, str]:
    """Reference, what was obtained, and the tolerance."""
    if row.check is None:
        return "–", "–", "–"
    return f"{row.check.reference:.6g}", f"{row.check.obtained:.6g}", f"{row.check.tolerance:.2g}"


def _table(rows: list[Row]) -> Table:
    table = Table(title="Verification of the mechanics")
    for heading in ("check", "reference", "obtained", "tolerance", "passed", "time [s]", "source"):
        table.add_column(Text(heading), justify="left" if heading in ("check", "source") else "right")
    for name, group in groupby(rows, key=lambda row: row.benchmark):
        table.add_section()
        table.add_row(Text(name, style="bold"))
        for row in group:
            verdict, seconds = "yes" if row.passed else "NO", f"{row.seconds:.1f}"
            told = (row.check.name, row.check.source) if row.check else (row.problem, "")
            table.add_row(Text(told[0]), *_figures(row), verdict, seconds, Text(told[1]))
    return table
