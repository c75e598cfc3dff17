"""The code that results come from: the modules that parts of it reach by their imports, and the libraries' versions.

What is kept under a hash of it is not found again by other code. Imports are read in the sources, as what a function
imports when it runs is not loaded before.
"""

import ast
import hashlib
import importlib.util
import inspect
import re
import secrets
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache, lru_cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import Distribution, PackageNotFoundError, distribution, distributions
from pathlib import Path
from typing import Any

Part = Callable[..., Any]
"""A class or function."""

PACKAGE = __name__.partition(".")[0]

BESIDE = ("filelock", "h5py", "hydra", "matplotlib", "omegaconf", "rich")
"""Libraries that configure, store and show: another version of theirs computes the same."""

# An import from its first word to the end of its line or bracket.
_IMPORT = re.compile(rb"^([ \t]*)((?:from|import)\b[^\n(]*(?:\([^)]*\))?[^\n]*)$", re.MULTILINE)

_read: dict[str, tuple[ModuleSpec | None, bytes]] = {}
"""What was found in the file of a module, and the module that was loaded then."""


def digest(parts: Iterable[Part]) -> str:
    """SHA-256 of all code and versions of libraries that the results of these classes and functions come from."""
    files, libraries = reached(parts)
    whole = hashlib.sha256()
    for name, content in sorted(files.items()):
        whole.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    for name, version in sorted(libraries.items()):
        whole.update(f"{name} {version}\n".encode())
    return whole.hexdigest()


def reached(parts: Iterable[Part]) -> tuple[dict[str, bytes], dict[str, str]]:
    """Modules that these and base classes reach, with their content, and versions of the libraries there.

    What pip did not install counts as code; and with a library counts what it requires, as many leave the work to
    another one.
    """
    parts = tuple(parts)
    ours = {PACKAGE, *map(_top, parts)}
    all_bases = {base for part in parts for base in (part.__mro__ if isinstance(part, type) else (part,))}
    bases = {base for base in all_bases if _top(base) not in sys.stdlib_module_names}
    code = {f"{base.__module__}.{base.__qualname__}": _typed(base) for base in bases if _file(base.__module__) is None}
    libraries: dict[str, str] = {}
    waiting = {base.__module__ for base in bases}
    while waiting:
        name = waiting.pop()
        top = name.partition(".")[0]
        if name in code or top in sys.stdlib_module_names or top in BESIDE:
            continue
        library = None if top in ours else _distribution(top)
        if library is not None:
            libraries |= _versions(library)
        elif (file := _file(name)) is not None:
            code[name] = _content(name, file)
            if file.suffix == ".py":
                waiting.update(_imported(code[name], name, file.name == "__init__.py"))
    return code, libraries


def _top(part: Part) -> str:
    """Name of the package or module, at the top level, that a class or function is from."""
    return part.__module__.partition(".")[0]


def _typed(part: Part) -> bytes:
    """Source of what no file holds, as in a notebook; one that cannot be had is never the same again."""
    try:
        return inspect.getsource(part).encode()
    except (OSError, TypeError):
        return secrets.token_bytes()


def _file(module: str) -> Path | None:
    """File of a module, which is not loaded for that; None if it has none."""
    loaded = sys.modules.get(module)
    origin = getattr(loaded, "__file__", None) if loaded else getattr(_spec(module), "origin", None)
    return Path(origin) if origin and Path(origin).is_file() else None


def _spec(module: str) -> ModuleSpec | None:
    """How a module that is not loaded would be found; its package is not loaded either."""
    package = module.rpartition(".")[0]
    if not package:
        return importlib.util.find_spec(module)
    loaded = sys.modules.get(package)
    places = (
        getattr(loaded, "__path__", None) if loaded else getattr(_spec(package), "submodule_search_locations", None)
    )
    return PathFinder.find_spec(module, list(places)) if places else None


def _content(module: str, file: Path) -> bytes:
    """Content of the file when it was first asked for: one that was edited since is not what runs, unless reloaded."""
    spec = getattr(sys.modules.get(module), "__spec__", None)
    before, content = _read.get(module, (spec, None))
    if content is None or (before is not None and before is not spec):
        content = file.read_bytes()
    _read[module] = spec, content
    return content


@lru_cache(maxsize=1024)
def _imported(content: bytes, name: str, is_package: bool) -> frozenset[str]:
    """Names that the module `name` imports, and those of the packages above; some may be no modules."""
    found: set[str] = set()
    for statement in _imports(content, everywhere=not is_package):
        if isinstance(statement, ast.Import):
            found.update(alias.name for alias in statement.names)
            continue
        above = name.split(".")[: len(name.split(".")) + is_package - statement.level] if statement.level else []
        module = ".".join([*above, *filter(None, [statement.module])])
        found.update([module, *(f"{module}.{alias.name}" for alias in statement.names)])
    parts = [each.split(".") for each in found]
    return frozenset(".".join(each[:length]) for each in parts for length in range(1, len(each) + 1))


def _imports(content: bytes, everywhere: bool) -> Iterator[ast.Import | ast.ImportFrom]:
    """The imports of a source, or those at its top level alone: what the functions of a package import is for others.

    To parse whole files would take ten times as long.
    """
    for indent, text in _IMPORT.findall(content):
        if everywhere or not indent:
            try:
                statements = ast.parse(text).body
            except (SyntaxError, ValueError):  # words of a docstring
                continue
            yield from (each for each in statements if isinstance(each, ast.Import | ast.ImportFrom))


@cache
def _distribution(module: str) -> Distribution | None:
    """What pip installed a module with; None if it did not."""
    with suppress(PackageNotFoundError):
        return distribution(module)
    owns = f"\n{module}/__init__.py,"
    return next((each for each in distributions() if owns in f"\n{each.read_text('RECORD')}"), None)


@cache
def _versions(library: Distribution) -> dict[str, str]:
    """Version of a library, and of what it requires; extras left out."""
    about = library.metadata  # parsed anew at each call
    found = {about["Name"]: about["Version"]}
    for requirement in about.get_all("Requires-Dist") or ():
        text, _, condition = requirement.partition(";")
        name = re.split(r"[^\w.-]", text, maxsplit=1)[0]
        version = None if "extra" in condition or name in BESIDE else _version(name)
        if version is not None:
            found[name] = version
    return found


@cache
def _version(name: str) -> str | None:
    """Version of what goes by `name` in pip; None of what other systems need."""
    try:
        return distribution(name).version
    except PackageNotFoundError:
        return None
