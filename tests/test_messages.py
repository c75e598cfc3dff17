"""What a message tells to type is what can be typed."""

import shlex
import subprocess

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException

from pgdl_lab.running.messages import command, sentence, typed

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
