"""Writes `pgdl_lab/__init__.pyi`, by which editors and type checkers know what `import pgdl_lab` offers.

    python -m tests.stub

Names are imported when they are first asked for, and plugins are found by their folder: neither is seen without running
the package. `tests/test_api.py` fails when the file is no longer what is written here.
"""

import inspect
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import pgdl_lab
from pgdl_lab.core.registry import shipped_classes

PATH = Path(pgdl_lab.__file__).with_suffix(".pyi")


def text() -> str:
    """The content of the file."""
    classes = sorted(shipped_classes(), key=lambda cls: (cls.__bases__[0].__name__, cls.__name__))
    plugins = [cls for cls in classes if cls.__module__.startswith("pgdl_lab.plugins.")]
    hints = {hint for cls in plugins for hint in _fields(cls).values()}
    needed = {cls.__bases__[0] for cls in plugins} | {hint for hint in hints if isinstance(hint, type)}
    needed = {cls for cls in needed if cls.__name__ not in pgdl_lab._HOMES}
    imports = {f"from {cls.__module__} import {cls.__name__}" for cls in needed if cls.__module__ != "builtins"}
    imports |= {f"from {cls.__module__} import {cls.__name__} as {cls.__name__}" for cls in {*classes} - {*plugins}}
    imports |= {f"from pgdl_lab.{home} import {name} as {name}" for name, home in pgdl_lab._HOMES.items()}
    head = ['"""What `import pgdl_lab` offers; written by `python -m tests.stub`."""', ""]
    head += ["from dataclasses import dataclass", "from typing import Any", "", *sorted(imports), ""]
    head += ["__version__: str", "__all__: list[str]"]
    return "\n".join([*head, *(line for cls in plugins for line in _stub(cls))]) + "\n"


def _fields(cls: type) -> dict[str, Any]:
    """Types of the fields that a class adds to those of its base."""
    known = {field.name for field in fields(cls.__bases__[0])}  # type: ignore[arg-type]  # of a dataclass
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls) if field.name not in known}  # type: ignore[arg-type]


def _stub(cls: type) -> Iterator[str]:
    yield from ("", "@dataclass(frozen=True)", f"class {cls.__name__}({cls.__bases__[0].__name__}):")
    lines = [f"{name}: {inspect.formatannotation(hint)} = ..." for name, hint in _fields(cls).items()]
    # without these a type checker would hold it for abstract
    filled: Any = getattr(cls.__bases__[0], "__abstractmethods__", ())
    for name in sorted(filled):
        asked = isinstance(getattr(cls, name), property)
        lines += (
            ["@property", f"def {name}(self) -> Any: ..."]
            if asked
            else [f"def {name}(self, *args: Any, **kwargs: Any) -> Any: ..."]
        )
    yield from (f"    {line}" for line in lines or ["..."])


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")
