"""What README.md and the guides in docs/ promise: every command in them is run, as far as that is quick."""

import ast
import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from tests.conftest import CHECKOUT, Lab, composed

README = CHECKOUT / "README.md"
PAGES = [README, *sorted((CHECKOUT / "docs").glob("*.md"))]
SHORT = (
    *("finger.chambers=2", "finger.max_kpa=5", "fem.edge_mm=6", "fem.element=hex20", "observation.snapshots=4"),
    *("observation.points=800", "split.points=500", "trainer.max_epochs=2", "trainer.progress=false"),
)


def commands(page: Path) -> list[str]:
    """Commands in the blocks of a page that are marked as shell, and those in its tables and text."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    lines = [part for block in blocks for line in block.splitlines() for part in line.split(" && ")]
    return [line.strip() for line in lines if line.strip()] + re.findall(r"`(python (?:-m|benchmarks/)[^`]*)`", text)


ALL = [pytest.param(command, id=f"{page.name}: {command}") for page in PAGES for command in commands(page)]


def first_of_sweep(override: str) -> str:
    """The first of the values that a multirun goes through: `a=[b],[c]` becomes `a=[b]`."""
    key, _, value = override.partition("=")
    depth = 0
    for place, letter in enumerate(value):
        depth += (letter in "[{(") - (letter in "]})")
        if letter == "," and depth == 0:
            return f"{key}={value[:place]}"
    return override


def check(command: str) -> None:
    """Run a command as far as it is quick; one that this test does not know is a failure."""
    program, *given = shlex.split(command, comments=True)
    match [Path(program).name, *given]:
        case ["python3", "-m", "venv", _]:
            pass  # .ci/run makes it
        case ["pip", "install", *options]:
            project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
            assert options[:2] == ["-c", "constraints.txt"] and (CHECKOUT / "constraints.txt").is_file()
            extras = re.findall(r"\w+", options[-1].partition("[")[2])
            assert set(extras) <= project["optional-dependencies"].keys()
        case ["python", "-m", "pgdl_lab", *choices]:
            typed = [first_of_sweep(choice) for choice in choices if "=" in choice and "…" not in choice]
            assert all("=" in choice or choice in ("-m", "--cfg", "job", "--help", "…") for choice in choices)
            late = r"sweep=|\+?hydra[./]|experiment=(choose|architecture)/|resume="  # Hydra's own, or left by a run
            pages = r"loss.*area"  # a plugin of these pages, trained below
            spread = r"[\w.]+=(range|interval|tag|choice)\("  # values of a search: of a setting that is there
            config = composed(*(choice for choice in typed if not re.match(f"{late}|{pages}|{spread}", choice)))
            for choice in typed:
                key = choice.partition("=")[0]
                assert not re.match(spread, choice) or OmegaConf.select(config, key) is not None, f"no setting {key}"
        case ["sbatch", _, script, *choices]:
            assert (CHECKOUT / script).is_file()
            check(shlex.join(["python", "-m", "pgdl_lab", "-m", *choices]))
        case ["python", script, *options] if (CHECKOUT / script).is_file():
            source = (CHECKOUT / script).read_text(encoding="utf-8")
            ast.parse(source)
            assert all(option in source for option in options if option.startswith("--"))
        case ["pytest", *_] | ["mlflow", "ui"]:
            pass  # the one runs this, the other serves until it is stopped
        case _:
            pytest.fail(f"tests/test_readme.py does not know how to run: {command}")


@pytest.mark.parametrize("command", ALL)
def test_commands_can_be_typed(command: str) -> None:
    check(command)


def test_unknown_commands_are_noticed() -> None:
    for command in ("rm -rf runs", "python benchmarks/gone.py", "python benchmarks/latency.py --slow"):
        with pytest.raises((AssertionError, pytest.fail.Exception)):
            check(command)
    with pytest.raises(Exception, match="modle"):
        check("python -m pgdl_lab modle=pod")


def test_pages_link_to_what_is_there() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\((?!https?://|#)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_loss_of_the_guide_trains(lab: Lab, tmp_path: Path) -> None:
    page = (CHECKOUT / "docs" / "your_loss.md").read_text(encoding="utf-8")
    (source,) = re.findall(r'```python\n("""Loss `area`.*?)```', page, re.DOTALL)
    (tmp_path / "plugins" / "loss").mkdir(parents=True)
    (tmp_path / "plugins" / "loss" / "area.py").write_text(source)
    done = lab("model=body", "model.modes=16", "loss=[data,boundary,area]", *SHORT, "yardstick=null")
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "runs" / "latest" / "metrics.json").read_text())
    assert "area" in metrics["losses"] and metrics["residuals"]["area"]
    assert (tmp_path / "runs" / "latest" / "surrogate.pt").stat().st_size > 0


def test_the_python_of_the_readme_runs(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (source,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, Any] = {}
    exec(source.replace("lab.Pneunet(chambers=6)", "lab.Pneunet(chambers=6), lab.Rod()"), names)  # half a second
    assert names["surrogate"].error["rms_mm"] < 0.01
    assert names["data"].pressures_kpa[-1] == 50
