"""One clear sentence for an error, Hydra's and OmegaConf's own included."""

import re
import shlex
from collections.abc import Iterator
from contextlib import suppress

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from pgdl_lab.core import paths
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.files import FULL, no_room
from pgdl_lab.core.registry import PARTS, choices, closest, field_names, names
from pgdl_lab.running.experiment import not_chosen

EXPECTED = (LabError, HydraException, OmegaConfBaseException)
"""Errors whose sentence says all; others need their traceback."""
TYPES = {
    "could not be converted to Integer": "a whole number, such as 4",
    "could not be converted to Float": "a number, such as 0.5",
    "is not a valid bool": "true or false",
    "is not a ListConfig, list or tuple": "a list, such as [1,2]",
}
"""What OmegaConf says of a value, and what its setting takes instead."""


def sentence(error: BaseException) -> str:
    """What went wrong, in one line."""
    for cause in _chain(error):
        if isinstance(cause, LabError):
            return _one_line(str(cause))
        if isinstance(cause, OSError) and cause.errno in FULL:
            return no_room(cause.filename or paths.ROOT)
        if isinstance(cause, ConfigKeyError | ConfigAttributeError):
            return _unknown_key(cause)
        if isinstance(cause, OmegaConfBaseException) and cause.full_key:
            text, raised, inner = str(cause.msg).splitlines()[0].partition(" raised while resolving interpolation: ")
            return inner if raised else _wrong_type(cause.full_key, text, cause.value) or f"{cause.full_key}: {text}"
        if isinstance(cause, OverrideParseException):
            return _unreadable(cause)
    choice = re.search(r"(?:find|load) '([\w/]+)/([^/']+)'", str(error))
    if choice and isinstance(error, MissingConfigException):
        return _unknown(choice[2], choices(choice[1]), choice[1])
    preset = re.match(r"In '([\w/]+)/([\w.-]+)': Config\w+Error .*full_key: (\S+)", str(error), re.S)
    if preset:
        group, name, key = preset.groups()
        return (
            f"{group}={name} sets {key}, which the chosen {key.partition('.')[0]} does not have: leave out one of the "
            "two choices."
        )
    text = _one_line(str(error)) or "no message"
    return text if isinstance(error, EXPECTED) else f"{type(error).__name__}: {text}"


def _chain(error: BaseException) -> Iterator[BaseException]:
    """Causes of an error, the deepest first: Hydra and OmegaConf wrap what others raise."""
    if error.__cause__ is not None:
        yield from _chain(error.__cause__)
    yield error


def _unknown_key(error: ConfigKeyError | ConfigAttributeError) -> str:
    name = str(error.key)
    known = (
        [str(key) for key in error.parent_node if key != "hydra"] if isinstance(error.parent_node, DictConfig) else []
    )
    place = str(error.full_key or name).rpartition(".")[0]
    if place == "loss" and name in names("loss"):
        return not_chosen(name, known)
    whole, _, part = place.rpartition(".")
    if PARTS.get(part) == whole:
        owners = [f"{whole}/{part}={other}" for other in names(part) if name in field_names(part, other)]
        if owners:
            return f"'{name}' is a field of {' and '.join(owners)}, which is not chosen: type that too."
    return _unknown(name, known, f"{place} field" if place else "choice or setting")


def _wrong_type(setting: str, told: str, value: object) -> str:
    """What OmegaConf says of a value of another type than its setting; empty of anything else."""
    for pattern, must in TYPES.items():
        if re.search(pattern, told):
            return f"{setting} is {value!r}; it must be {must}."
    if re.search("is not Optional|Incompatible value 'None'", told):
        return f"{setting} is null; it must have a value: leave it out to have its default."
    return ""


def _unreadable(error: OverrideParseException) -> str:
    """What Hydra's grammar does not take: text with signs in it has to be quoted."""
    key, _, value = error.override.partition("=")
    problem = _one_line(f"'{error.override}' cannot be read as key=value: {error.message}")
    if not value or value[0] in "[{(\"'" or not re.fullmatch(r"[\w@/.+~-]+", key):
        return problem
    return f"'{error.override}' holds signs that mean something to Hydra: quote the value, {typed(key, value)}"


def quoted(text: str) -> str:
    """Text as Hydra's grammar takes it for the same text: in quotes where it needs them."""
    with suppress(HydraException):
        if OverridesParser.create().parse_override(f"key={text}").value() == text:
            return text
    escaped = re.sub(r"(\\+)$", r"\1\1", re.sub(r"(\\*)'", r"\1\1\\'", text))
    return f"'{escaped}'"


def typed(key: str, value: object) -> str:
    """How to type a setting whose value is text, quoted where Hydra's grammar or the shell needs it."""
    setting = f"{key}={quoted(str(value))}"
    if re.fullmatch(r"[\w@%+=:,./~-]+", setting, re.ASCII):
        return setting
    return shlex.quote(setting) if re.search(r'["$`!]|\\(?=\\|$)', setting) else f'"{setting}"'


def command(*choices: str, **settings: object) -> str:
    """The command line with choices as they are and settings that are text."""
    return " ".join(["python -m pgdl_lab", *choices, *(typed(key, value) for key, value in settings.items())])


def _unknown(name: str, known: list[str], what: str) -> str:
    try:
        closest(name, known, what)
    except InputError as answer:
        return str(answer)
    return f"'{name}' is a {what}, but does not fit here."


def _one_line(text: str) -> str:
    return " ".join(text.split())
