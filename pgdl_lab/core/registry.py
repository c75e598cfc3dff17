"""The registry of plugins: what is registered can be typed on the command line.

A plugin is a frozen dataclass. Its fields are its configuration, so the decorator also keeps it as a typed node for
Hydra's ConfigStore, and no YAML file repeats the defaults. Hydra itself is imported by the command line alone: a robot
that loads a surrogate does without it.

    @register("finger", "bellows")
    @dataclass(frozen=True)
    class Bellows(Finger):
        folds: int = 6
"""

import importlib
import json
import logging
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from difflib import get_close_matches
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import MISSING, DictConfig, OmegaConf, flag_override

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.paths import BEST, CONF, SHIPPED_PLUGINS

KINDS = ("finger", "fem", "split", "loss", "model")
"""The plugin kinds: each is a config group, a folder in `plugins/` and an abstract class in `pgdl_lab/`."""
PARTS = {"material": "finger"}
"""Plugin kinds that are a field of another kind, here of `finger`: their config group is `finger/material`."""

_log = logging.getLogger(__name__)
_plugins: dict[str, dict[str, type]] = {kind: {} for kind in (*KINDS, *PARTS)}
_nodes: dict[tuple[str, str], tuple[DictConfig, str | None]] = {}
"""Configuration and package of what can be typed, by group and name."""

Plugin = TypeVar("Plugin", bound=type)
Settings = TypeVar("Settings")


def _file_of(cls: type) -> str | None:
    return getattr(sys.modules.get(cls.__module__), "__file__", None)


def _require_typed(cls: type, kind: str, name: str) -> None:
    """Refuse a field whose default was changed without its type, which a dataclass would leave as it was."""
    for field in fields(cls) if is_dataclass(cls) else ():
        given = vars(cls).get(field.name, field.default)
        if given is not field.default and not isinstance(given, property):
            raise InputError(
                f"{kind} '{name}' sets {field.name} = {given!r} without a type, so that it would be left as it was: "
                f"write {field.name}: {type(given).__name__} = {given!r} below @dataclass(frozen=True)."
            )


def register(kind: str, name: str) -> Callable[[Plugin], Plugin]:
    """Class decorator that makes a frozen dataclass the choice `name` of `kind`.

    Sets the class attributes `kind` and `name`.

    Raises
    ------
    InputError
        If there is no such kind, or another class has that name.
    """
    known = _plugins[closest(kind, _plugins, "plugin kind")]

    def decorate(cls: Plugin) -> Plugin:
        _require_typed(cls, kind, name)
        other = known.get(name)
        if other is not None and _file_of(other) == _file_of(cls) is not None and other.__module__ != cls.__module__:
            raise InputError(
                f"{kind} '{name}' of {_file_of(cls)} was imported under another name: call pgdl_lab.discover() and "
                f"import it as pgdl_lab.plugins.{kind}.{cls.__module__.rpartition('.')[2]}."
            )
        if other is not None and (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
            raise InputError(f"{kind} '{name}' is registered by {other.__module__} and {cls.__module__}: rename one.")
        named: Any = cls
        named.kind, named.name = kind, name
        known[name] = cls
        node = config_node(cls)
        # Hydra cannot put one part in the place of another, so that each comes in by the defaults list.
        own = [{part: _own_part(node, part, kind, name)} for part, whole in PARTS.items() if whole == kind]
        if own:
            with flag_override(node, "struct", False):
                node["defaults"] = ["_self_", *own]
        # Several losses act at once, so each has its own place `loss.<name>`.
        _store(
            f"{PARTS[kind]}/{kind}" if kind in PARTS else kind, name, node, f"loss.{name}" if kind == "loss" else None
        )
        return cls

    return decorate


def _store(group: str, name: str, node: DictConfig, package: str | None = None) -> None:
    _nodes[group, name] = node, package


def store() -> None:
    """Put all that is registered into Hydra's ConfigStore."""
    from hydra.core.config_store import ConfigStore

    for (group, name), (node, package) in _nodes.items():
        ConfigStore.instance().store(group=group, name=name, node=node, package=package, provider="pgdl_lab")


def _own_part(node: DictConfig, part: str, kind: str, name: str) -> str:
    """Take the default of a `part` out of `node`; what to type for it.

    That is the name of its plugin, or, if the plugin `name` gives it values of its own, `name`.
    """
    own: Any = OmegaConf.to_object(node[part])
    node[part] = MISSING
    if own == type(own)():
        chosen: str = own.name
        return chosen
    _store(f"{kind}/{part}", name, config_node(own))
    return name


def config_node(plugin: Any) -> DictConfig:
    """Typed configuration of a plugin class with its defaults, or of an instance; open to overrides."""
    node: DictConfig = OmegaConf.structured(plugin)
    _lift_readonly(node)
    return node


def settings_of(kind: type[Settings], name: str, given: Mapping[str, Any]) -> Settings:
    """The settings `given` under a `name` on the command line, as an instance of the dataclass `kind`.

    Raises
    ------
    OmegaConfBaseException
        When one has another type, or there is none of that name; it knows where.
    InputError
        When a value lies outside its limits.
    """
    whole: Any = OmegaConf.merge({name: config_node(kind)}, {name: given})
    made: Any = OmegaConf.to_object(whole[name])
    return made


def _lift_readonly(node: Any) -> None:
    """Open a node to overrides: OmegaConf makes those of frozen dataclasses read-only, nested ones too."""
    if isinstance(node, DictConfig) and not node._is_none() and not node._is_missing():
        node._set_flag("readonly", False)  # None would give way to that of a node this one is merged into
        for key in node:
            _lift_readonly(node._get_node(key))


def discover(*kinds: str) -> None:
    """Import every plugin, or those of `kinds`: shipped, in the folder `plugins/` of the root, in installed packages.

    These are the modules of `pgdl_lab.plugins`, then the entry points of that name. A plugin that cannot be imported is
    named in a warning, and the others still load.
    """
    from pgdl_lab import plugins

    plugins.discover_own()
    for module in _modules(kinds or tuple(_plugins)):
        _load(module, partial(importlib.import_module, module))
    for entry in sorted(entry_points(group="pgdl_lab.plugins")):
        _load(f"entry point {entry.name} = {entry.value}", entry.load)


def discover_shipped(kind: str) -> None:
    """Import the plugins of a kind that come with the lab, and no others."""
    for module in _modules([kind], SHIPPED_PLUGINS / kind):
        _load(module, partial(importlib.import_module, module))


def shipped_classes() -> list[type]:
    """The plugins that come with the lab; others are neither imported nor among them."""
    for kind in _plugins:
        discover_shipped(kind)
    own = [module for kind in _plugins for module in _modules([kind], SHIPPED_PLUGINS / kind)]
    classes = [cls for known in _plugins.values() for cls in known.values()]
    return [cls for cls in classes if cls.__module__ in own or cls.__module__.startswith("pgdl_lab.mechanics.")]


def _modules(kinds: Iterable[str], only: Path | None = None) -> Iterator[str]:
    """Names of the modules with plugins of `kinds`, or of those in the folder `only`."""
    for kind in kinds:
        try:
            package = importlib.import_module(f"pgdl_lab.plugins.{kind}")
        except ModuleNotFoundError:
            continue
        found: dict[str, str] = {}
        for folder in package.__path__:
            for _, name, _ in pkgutil.iter_modules([folder]):
                if name in found:
                    _log.warning(
                        "Plugin %s/%s.py is left out: %s/ has one of that name; rename it", folder, name, found[name]
                    )
                elif not name.startswith("_"):
                    found[name] = folder
        wanted = (name for name, folder in found.items() if only in (None, Path(folder).resolve()))
        yield from (f"{package.__name__}.{name}" for name in sorted(wanted))


def _load(label: str, load: Callable[[], object]) -> None:
    try:
        load()
    except Exception as error:  # anything may go wrong in a file that someone else wrote
        _log.warning("Plugin %s is left out: %s: %s", label, type(error).__name__, error)
        _log.debug("Traceback of %s", label, exc_info=True)


def names(kind: str) -> list[str]:
    """Names of the registered plugins of a kind, sorted."""
    return sorted(_plugins[kind])


def plugin(kind: str, name: str) -> type:
    """Class of a registered plugin.

    Raises
    ------
    InputError
        If there is none of that name: the message lists the choices and the closest one.
    """
    return _plugins[kind][closest(name, names(kind), kind)]


def choices(group: str) -> list[str]:
    """What may be typed after `group=`: registered plugins and YAML files of `conf/<group>/`, sorted.

    Searches leave files of the group `experiment`.
    """
    from hydra.core.config_store import ConfigStore

    files = (path.stem for folder in (CONF, BEST) for path in (folder / group).glob("*.yaml"))
    stored: Any = ConfigStore.instance().repo
    for folder in group.split("/"):
        stored = stored.get(folder, {})
    return sorted({*files, *(key.removesuffix(".yaml") for key in stored if key.endswith(".yaml"))})


def closest(name: str, known: Iterable[str], what: str) -> str:
    """`name` if it is known.

    Raises
    ------
    InputError
        If it is not: the message lists the choices and the closest one.
    """
    known = list(known)
    if name in known:
        return name
    close = get_close_matches(name, known, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    raise InputError(f"There is no {what} '{name}'.{hint} Choices: {', '.join(known) or 'none'}.")


def describe(plugin: Any) -> dict[str, Any]:
    """Name and fields of a plugin instance and of its parts, in JSON types only."""
    values = {"name": plugin.name, **asdict(plugin)}
    for part in PARTS.keys() & values.keys():
        values[part] = describe(getattr(plugin, part))
    described: dict[str, Any] = json.loads(json.dumps(values, default=_plain))
    return described


def restored(kind: str, description: Mapping[str, Any]) -> DictConfig:
    """Typed configuration from what `describe` gave.

    Raises
    ------
    InputError
        If a plugin that it names is no longer there.
    """
    values = dict(description)
    node = config_node(plugin(kind, values.pop("name")))
    for part in PARTS.keys() & values.keys():
        if "name" in values[part]:
            node[part] = restored(part, values.pop(part))
    merged = OmegaConf.merge(node, values)
    assert isinstance(merged, DictConfig)
    return merged


def require_values(stored: Any, path: Path) -> None:
    """Check that nothing in settings from a file is to be worked out by OmegaConf.

    What stands for `${…}` is up to functions that this program registered: a file must not call them.

    Raises
    ------
    InputError
        When there is such a text.
    """
    for text in _texts(stored):
        if "${" in text:
            raise InputError(f"{path} holds the setting '{text}': stored settings are values, never ${{…}}.")


def _texts(tree: Any) -> Iterator[str]:
    """All texts in nested settings."""
    if isinstance(tree, str):
        yield tree
    elif isinstance(tree, dict):
        yield from (text for pair in tree.items() for part in pair for text in _texts(part))
    elif isinstance(tree, list):
        yield from (text for part in tree for text in _texts(part))


def field_names(kind: str, name: str) -> list[str]:
    """Fields of a registered plugin."""
    return [field.name for field in fields(plugin(kind, name))]


def _plain(value: Any) -> Any:
    """JSON form of what `json` does not know: enum members by name, arrays as lists, paths as text."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return getattr(value, "name", None) or str(value)
