"""What Hydra and OmegaConf want to be told in one of their versions and not in the next."""

from collections.abc import Callable
from inspect import signature
from typing import Any

from hydra import main
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

MAY_BE_MADE = ["pgdl_lab.*", "hydra_plugins.*", "optuna.*"]
"""Packages whose classes a configuration may name (`_target_`)."""

_BEFORE_1_4 = "execution_whitelist" not in signature(main).parameters

BASE: dict[str, Any] = {"version_base": "1.3"} if _BEFORE_1_4 else {}
"""For `hydra.main` and `hydra.initialize`: the version whose behaviour is meant."""

TRUST: dict[str, Any] = {} if _BEFORE_1_4 else {"execution_whitelist": MAY_BE_MADE}
"""For `hydra.main`: the classes that may be made."""


def register_resolver(name: str, function: Callable[..., Any], use_cache: bool = False) -> None:
    """Make `function` what `${name:…}` calls in a configuration; with `use_cache`, once for the same arguments."""
    register: Any = OmegaConf.register_resolver
    if "replace" not in signature(register).parameters:  # before OmegaConf 2.4 that was another one
        register = OmegaConf.register_new_resolver
    register(name, function, replace=True, use_cache=use_cache)


def share_store() -> None:
    """Keep one ConfigStore for the process, as Hydra means it.

    Hydra copies its repository of configurations before it lists a group or composes, and with it the store and every
    choice in it, so that `--help` would copy all of them some hundred times. What is loaded from the store is copied
    anyway.
    """
    ConfigStore.__deepcopy__ = lambda store, _: store  # type: ignore[attr-defined]
