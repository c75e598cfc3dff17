"""What a message tells to type is what can be typed."""

import re
import shlex
import subprocess
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pgdl_lab.core.registry import discover, plugin, settings_of
from pgdl_lab.learning.settings import TrainerSettings
from pgdl_lab.running.messages import command, sentence, typed
from pgdl_lab.studies.chart.settings import ChartSettings
from pgdl_lab.studies.choosing.settings import ChooseSettings
from pgdl_lab.studies.stability.run import StabilitySettings

discover()

VALUES = [
    "plain.vtu", "/a/b-c_1.msh", "ä.vtu", "o'n.vtu", "it's \"so\".vtu", "two words", "p%20q", "q?r", "x<1 and z>=2",
    "$HOME/`id`.vtu", "a,b", "[x]", "{y}", "(z)", "a=b", "a:b", "#1", "back\\slash", "ends\\", "\\'", "1e3", "null",
    "true", "", " ", "a;b|c&d", "~/x", "*", "你好.vtu", "!event", "${seed}",
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES)
def test_a_setting_is_read_back_as_it_was_from_shell_and_grammar(value: str) -> None:
    (word,) = shlex.split(typed("finger.path", value))
    found = OverridesParser.create().parse_override(word).value()
    assert str(found) == value


@pytest.mark.parametrize("value", VALUES)
def test_the_same_in_a_shell(value: str) -> None:
    line = command("task=log", run=value)
    script = 'python() { printf "%s\\0" "$@"; }; ' + line
    words = subprocess.run(["bash", "-c", script], capture_output=True, check=True).stdout.decode().split("\0")
    assert words[:3] == ["-m", "pgdl_lab", "task=log"]
    assert str(OverridesParser.create().parse_override(words[3]).value()) == value


def test_text_with_signs_is_quoted_by_the_refusal() -> None:
    for override, typed_instead in (
        ("finger.path=ä.vtu", "finger.path='ä.vtu'"),
        ("finger.path=a#b.vtu", "finger.path='a#b.vtu'"),
        ("finger.clamp=x<1", "finger.clamp='x<1'"),
    ):
        with pytest.raises(OverrideParseException) as error:
            OverridesParser.create().parse_overrides([override])
        told = sentence(error.value)
        assert "quote the value" in told and typed_instead in told and "\n" not in told


@pytest.mark.parametrize(
    ("setting", "value", "told"),
    [
        ("model.depth", "two", "model.depth is 'two'; it must be a whole number, such as 4."),
        ("model.depth", 1.5, "model.depth is 1.5; it must be a whole number, such as 4."),
        ("model.depth", [1], "model.depth is [1]; it must be a whole number, such as 4."),
        ("model.depth", None, "model.depth is null; it must have a value: leave it out to have its default."),
        ("model.interval", 3, "model.interval is 3; it must be a list, such as [1,2]."),
        ("model.interval", ["a"], "model.interval[0] is 'a'; it must be a number, such as 0.5."),
        ("trainer.progress", "maybe", "trainer.progress is 'maybe'; it must be true or false."),
    ],
)
def test_a_value_of_the_wrong_type_is_told_in_the_words_of_the_lab(setting: str, value: object, told: str) -> None:
    config = OmegaConf.create({"model": OmegaConf.structured(plugin("model", "mlp")), "trainer": TrainerSettings})
    for part in config.values():
        OmegaConf.set_readonly(part, False)
    with pytest.raises(OmegaConfBaseException) as error:
        OmegaConf.update(config, setting, value)
    assert sentence(error.value) == told


@pytest.mark.parametrize(
    ("kind", "name", "given", "told"),
    [
        (StabilitySettings, "stability", {"updates": "x"}, "stability.updates is 'x'; it must be a whole number"),
        (ChartSettings, "chart", {"meshes": ["a"]}, r"chart.meshes\[0\] is 'a'; it must be a number"),
        (ChooseSettings, "choose", {"meshes": 2}, "choose.meshes is 2; it must be a list"),
        (ChartSettings, "chart", {"meshs": [1]}, "There is no chart field 'meshs'. Did you mean 'meshes'"),
    ],
)
def test_settings_of_tasks_have_types_too(kind: type, name: str, given: dict[str, Any], told: str) -> None:
    with pytest.raises(OmegaConfBaseException) as error:
        settings_of(kind, name, given)
    assert re.match(told, sentence(error.value))
