"""What every registered plugin must keep, the user's included."""

import json
import pickle
import re
from dataclasses import fields
from typing import Any

import pytest
from omegaconf import DictConfig, OmegaConf

from pgdl_lab.core import registry
from pgdl_lab.core.split import Split
from pgdl_lab.learning.loss import Loss
from pgdl_lab.learning.model import Model
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.material import Material
from tests.conftest import composed

BASES = {"fem": Fem, "finger": Finger, "loss": Loss, "material": Material, "model": Model, "split": Split}

registry.discover()
PLUGINS = [pytest.param(kind, name, id=f"{kind}={name}") for kind in BASES for name in registry.names(kind)]


def stored(kind: str, name: str) -> DictConfig:
    """What the command line composes for a plugin."""
    whole = registry.PARTS.get(kind)
    typed = f"loss=[{name}]" if kind == "loss" else f"{whole}/{kind}={name}" if whole else f"{kind}={name}"
    node = composed(typed)
    for key in (whole, kind, name if kind == "loss" else None):
        node = node if key is None else node[key]
    assert isinstance(node, DictConfig)
    return node


def default(kind: str, name: str) -> Any:
    return OmegaConf.to_object(stored(kind, name))


@pytest.mark.parametrize(("kind", "name"), PLUGINS)
class TestPlugin:
    def test_belongs_to_its_kind(self, kind: str, name: str) -> None:
        plugin = default(kind, name)
        assert isinstance(plugin, BASES[kind])
        assert (plugin.kind, plugin.name) == (kind, name)

    def test_lies_in_the_file_that_bears_its_name(self, kind: str, name: str) -> None:
        module = registry.plugin(kind, name).__module__
        if module.startswith("pgdl_lab.plugins."):
            assert module == f"pgdl_lab.plugins.{kind}.{name}"

    def test_is_composed_with_the_defaults_of_its_class(self, kind: str, name: str) -> None:
        assert default(kind, name) == registry.plugin(kind, name)()

    def test_survives_pickling(self, kind: str, name: str) -> None:
        plugin = default(kind, name)
        assert pickle.loads(pickle.dumps(plugin)) == plugin

    def test_description_makes_it_again(self, kind: str, name: str) -> None:
        plugin = default(kind, name)
        description = json.loads(json.dumps(registry.describe(plugin)))
        assert description["name"] == name
        assert OmegaConf.to_object(registry.restored(kind, description)) == plugin

    def test_is_frozen_but_configurable(self, kind: str, name: str) -> None:
        plugin, node = default(kind, name), stored(kind, name)
        assert type(plugin).__dataclass_params__.frozen
        for field in fields(plugin):
            node[field.name] = node[field.name]

    def test_documents_itself_and_every_field(self, kind: str, name: str) -> None:
        cls = registry.plugin(kind, name)
        assert cls.__doc__ and not cls.__doc__.startswith(f"{cls.__name__}(")
        documented = {field for base in cls.__mro__ for field in documented_fields(base.__dict__.get("__doc__") or "")}
        assert {field.name for field in fields(cls)} <= documented


def documented_fields(docstring: str) -> list[str]:
    """Names in the section `Attributes` of a NumPy docstring."""
    _, _, section = docstring.partition("Attributes\n")
    heads = re.findall(r"^    (\w+(?:, \w+)*)$", section, flags=re.MULTILINE)
    return [name for head in heads for name in head.split(", ")]
