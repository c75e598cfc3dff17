"""One clear sentence for an error, Hydra's and OmegaConf's own included."""

import re
from collections.abc import Iterator

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException

from pgdl_lab.errors import InputError, LabError
from pgdl_lab.registry import choices, closest

EXPECTED = (LabError, HydraException, OmegaConfBaseException)
"""Errors whose sentence says all; others need their traceback."""


def sentence(error: BaseException) -> str:
    """What went wrong, in one line."""
    for cause in _chain(error):
        if isinstance(cause, LabError):
            return _one_line(str(cause))
        if isinstance(cause, ConfigKeyError):
            return _unknown_key(cause)
        if isinstance(cause, OmegaConfBaseException) and cause.full_key:
            return _one_line(f"{cause.full_key}: {str(cause.msg).splitlines()[0]}")
        if isinstance(cause, OverrideParseException):
            return _one_line(f"'{cause.override}' cannot be read as key=value: {cause.message}")
    choice = re.search(r"(?:find|load) '([\w/]+)/([^/']+)'", str(error))
    if choice and isinstance(error, MissingConfigException):
        return _unknown(choice[2], choices(choice[1]), choice[1])
    text = _one_line(str(error)) or "no message"
    return text if isinstance(error, EXPECTED) else f"{type(error).__name__}: {text}"


def _chain(error: BaseException) -> Iterator[BaseException]:
    """The causes of an error, the deepest first: Hydra wraps what others raise."""
    if error.__cause__ is not None:
        yield from _chain(error.__cause__)
    yield error


def _unknown_key(error: ConfigKeyError) -> str:
    parent = error.parent_node
    full_key = str(error.full_key or error.key)
    place = full_key.rpartition(".")[0]
    known = [str(key) for key in parent] if isinstance(parent, DictConfig) else []
    return _unknown(str(error.key), known, f"setting '{place}.…' named" if place else "choice or setting")


def _unknown(name: str, known: list[str], what: str) -> str:
    try:
        closest(name, known, what)
    except InputError as answer:
        return str(answer)
    return f"'{name}' is a {what}, but does not fit here."


def _one_line(text: str) -> str:
    return " ".join(text.split())
