import copy
import importlib
import json
import logging
import sys
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from pgdl_lab import plugins
from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.running.composing import store_choices

PLUGIN = """
from dataclasses import dataclass
from pgdl_lab.core.registry import register

@register("split", "{name}")
@dataclass(frozen=True)
class Odd:
    points: int = 7
"""


def copied(folder: dict[str, Any]) -> dict[str, Any]:
    return {key: copied(entry) if isinstance(entry, dict) else entry for key, entry in folder.items()}


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the registry, Hydra's store and the imported modules as they were."""
    importlib.import_module("numpy")  # which cannot be imported a second time
    monkeypatch.setattr(registry, "_plugins", {kind: dict(known) for kind, known in registry._plugins.items()})
    monkeypatch.setattr(registry, "_nodes", dict(registry._nodes))
    store = ConfigStore.instance()
    monkeypatch.setattr(store, "repo", copied(store.repo))
    monkeypatch.setattr(sys, "modules", sys.modules.copy())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A plugin folder of the user's, for splits."""
    monkeypatch.setattr(plugins, "__path__", [*plugins.__path__, str(tmp_path)])
    for name in [name for name in sys.modules if name.startswith("pgdl_lab.plugins.")]:
        del sys.modules[name]
    (tmp_path / "split").mkdir()
    return tmp_path / "split"


@dataclass(frozen=True)
class Part:
    length_mm: float = 2.0


@dataclass(frozen=True)
class Thing:
    sizes: list[float] = field(default_factory=lambda: [1.0, 2.0])
    part: Part = field(default_factory=Part)


def test_registered_class_can_be_found_configured_and_described() -> None:
    registry.register("split", "thing")(Thing)
    assert registry.plugin("split", "thing") is Thing
    assert "thing" in registry.names("split")
    node = registry.config_node(Thing)
    node.part.length_mm, node.sizes = 3, [4]
    made = OmegaConf.to_object(node)
    assert made == Thing([4.0], Part(3.0))
    assert registry.describe(made) == {"name": "thing", "sizes": [4.0], "part": {"length_mm": 3.0}}


def test_a_taken_name_is_refused_with_both_modules() -> None:
    registry.register("split", "thing")(Thing)
    other = type("Other", (Thing,), {"__module__": "somewhere.else"})
    with pytest.raises(InputError, match=rf"split 'thing' is registered by {__name__} and somewhere\.else"):
        registry.register("split", "thing")(other)
    assert registry.plugin("split", "thing") is Thing


def test_the_same_class_may_be_registered_again() -> None:
    registry.register("split", "thing")(Thing)
    registry.register("split", "thing")(Thing)


def test_unknown_kind() -> None:
    with pytest.raises(InputError, match="There is no plugin kind 'fingr'. Did you mean 'finger'"):
        registry.register("fingr", "thing")


def test_unknown_name_lists_choices_and_the_closest() -> None:
    registry.register("split", "thing")(Thing)
    with pytest.raises(InputError, match=r"There is no split 'thnig'\. Did you mean 'thing'\? Choices: .*thing"):
        registry.plugin("split", "thnig")


def test_user_file_is_found_and_a_broken_one_only_warns(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder / "aa_broken.py").write_text("import no_such_module")
    (folder / "odd.py").write_text(PLUGIN.format(name="odd"))
    (folder / "_helper.py").write_text("raise RuntimeError")
    registry.discover()
    assert registry.plugin("split", "odd").__module__ == "pgdl_lab.plugins.split.odd"
    warnings = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warnings == [
        "Plugin pgdl_lab.plugins.split.aa_broken is left out: ModuleNotFoundError: No module named 'no_such_module'"
    ]


def test_a_name_clash_between_files_warns_with_both_modules(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder / "first.py").write_text(PLUGIN.format(name="odd"))
    (folder / "second.py").write_text(PLUGIN.format(name="odd"))
    registry.discover()
    assert registry.plugin("split", "odd").__module__ == "pgdl_lab.plugins.split.first"
    assert "by pgdl_lab.plugins.split.first and pgdl_lab.plugins.split.second" in caplog.text


def test_a_file_that_another_hides_is_named(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder / "random.py").write_text(PLUGIN.format(name="odd"))
    registry.discover()
    assert f"{folder}/random.py is left out" in caplog.text
    assert "odd" not in registry.names("split")


def test_entry_point_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "somebodys_lab.py").write_text(PLUGIN.format(name="foreign"))
    monkeypatch.syspath_prepend(tmp_path)
    entries = [EntryPoint("a", "somebodys_lab", "pgdl_lab.plugins"), EntryPoint("b", "gone", "pgdl_lab.plugins")]
    monkeypatch.setattr(registry, "entry_points", lambda group: entries if group == "pgdl_lab.plugins" else [])
    registry.discover()
    assert registry.plugin("split", "foreign").__module__ == "somebodys_lab"


def test_describe_gives_json_types() -> None:
    registry.register("split", "thing")(Thing)
    described = registry.describe(Thing())
    assert json.loads(json.dumps(described)) == described


def test_a_file_that_is_imported_under_another_name_is_told_how(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (folder / "own.py").write_text(PLUGIN.format(name="odd"))
    monkeypatch.syspath_prepend(folder)
    importlib.import_module("own")
    registry.discover()
    assert "pgdl_lab.discover() and import it as pgdl_lab.plugins.split.own" in caplog.text
    sys.modules.pop("own")


def test_a_field_without_its_type_is_refused() -> None:
    @dataclass(frozen=True)
    class Base:
        share: float = 0.5

    with pytest.raises(InputError, match="split 'odd' sets share = 0.7 without a type.* write share: float = 0.7"):

        @registry.register("split", "odd")
        class Bare(Base):
            share = 0.7

    with pytest.raises(InputError, match="sets share = 0.7 without a type"):

        @registry.register("split", "odd")
        @dataclass(frozen=True)
        class Untyped(Base):
            share = 0.7

    assert "odd" not in registry.names("split")


def test_one_store_serves_all_copies_and_what_is_loaded_is_a_copy() -> None:
    store_choices()
    store = ConfigStore.instance()
    assert copy.deepcopy({"repository": store})["repository"] is store
    first, second = (store.load("split/random.yaml").node for _ in range(2))
    first.points = 7
    assert second.points != 7
