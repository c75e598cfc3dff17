"""What every registered plugin must keep, the user's included."""

import json
import pickle
import re
from dataclasses import fields
from typing import Any

import pytest
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from pgdl_lab import registry
from pgdl_lab.fem import Fem
from pgdl_lab.finger import Finger
from pgdl_lab.loss import Loss
from pgdl_lab.model import Model
from pgdl_lab.split import Split

BASES = {"fem": Fem, "finger": Finger, "loss": Loss, "model": Model, "split": Split}

registry.discover()
PLUGINS = [pytest.param(kind, name, id=f"{kind}={name}") for kind in registry.KINDS for name in registry.names(kind)]


def stored(kind: str, name: str) -> DictConfig:
    """The node that the command line sees."""
    node = ConfigStore.instance().repo[kind][f"{name}.yaml"].node
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

    def test_survives_pickling(self, kind: str, name: str) -> None:
        plugin = default(kind, name)
        assert pickle.loads(pickle.dumps(plugin)) == plugin

    def test_description_makes_it_again(self, kind: str, name: str) -> None:
        plugin = default(kind, name)
        description = json.loads(json.dumps(registry.describe(plugin)))
        assert description.pop("name") == name
        again = OmegaConf.to_object(OmegaConf.merge(registry.config_node(type(plugin)), description))
        assert again == plugin

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
