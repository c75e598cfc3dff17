"""How the house stands: each room uses only the rooms below it, and no two files need each other."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

from tests.conftest import CHECKOUT

FLOORS = ("core", "mechanics", "surrogate", "learning", "export assessment", "running", "search", "studies", "top")
"""From the ground up; rooms of one floor know nothing of each other."""
WHERE = {"plugins": "core", "tasks": "top", "api": "top", "cli": "top", "__main__": "top"}
"""Rooms of what does not lie in a folder of that name."""
FACE = "pgdl_lab"
"""What hands names on without importing them, and knows the version."""


def modules() -> dict[str, Path]:
    def name(file: Path) -> str:
        return ".".join(file.relative_to(CHECKOUT).with_suffix("").parts).removesuffix(".__init__")

    return {name(file): file for file in (CHECKOUT / "pgdl_lab").rglob("*.py")}


def imported(file: Path, known: set[str]) -> set[str]:
    """Modules of the lab that a file imports, in functions and for type checkers too."""
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    froms = [node for node in nodes if isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith("pgdl_lab.")]
    named = {(str(node.module), f"{node.module}.{alias.name}") for node in froms for alias in node.names}
    return {whole if whole in known else module for module, whole in named} - {FACE}


def arrows() -> dict[str, set[str]]:
    known = modules()
    return {module: imported(file, {*known}) - {module} for module, file in known.items() if module != FACE}


def test_each_room_uses_only_those_below() -> None:
    floor = {room: number for number, rooms in enumerate(FLOORS) for room in rooms.split()}

    def room(module: str) -> str:
        folder = module.split(".")[1]
        return WHERE.get(folder, folder)

    pairs = [(module, other) for module, others in arrows().items() for other in others if room(module) != room(other)]
    assert len(pairs) > 400
    assert [pair for pair in pairs if floor[room(pair[0])] <= floor[room(pair[1])]] == []


def test_no_two_files_need_each_other() -> None:
    TopologicalSorter(arrows()).prepare()  # raises CycleError, which names them


def test_imports_are_seen_wherever_they_stand(tmp_path: Path) -> None:
    file = tmp_path / "below.py"
    file.write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from pgdl_lab.running import cache\n"
        "def late():\n    from pgdl_lab.learning.loss import Loss\n"
    )
    known = {"pgdl_lab.running.cache", "pgdl_lab.learning.loss"}
    assert imported(file, known) == known
