import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import Lab

PLUGIN = '''
from dataclasses import dataclass
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.core.registry import register

@register("fem", "quick")
@dataclass(frozen=True)
class Quick(Fem):
    """A model that fails as it is told.

    Attributes
    ----------
    failure
        "lab", "bug" or "interrupt".
    """
    failure: str = "lab"

    def __post_init__(self):
        if self.failure == "input":
            raise InputError("fem.failure is 'input'; it must be lab or bug.")

    def simulate(self, finger, observation):
        raise {"lab": LabError("The finger burst."), "bug": TypeError("1 + 'a'")}.get(self.failure, KeyboardInterrupt)
'''

HEAVY = {"lightning", "matplotlib", "mlflow", "optuna", "scipy", "skfem", "torch"}

IMPORTED = f"""
import sys
from pgdl_lab.cli import main
try:
    main()
except SystemExit:
    pass
print("HEAVY", sorted({HEAVY!r} & set(sys.modules)))
"""


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    """A user's plugin folder with `fem=quick`."""
    folder = tmp_path / "plugins" / "fem"
    folder.mkdir(parents=True)
    (folder / "quick.py").write_text(PLUGIN)
    return folder


def run_folders(root: Path) -> list[Path]:
    return [path for path in (root / "runs").iterdir() if re.match(r"\d{4}-", path.name)]


@pytest.mark.parametrize("option", [["--help"], ["--cfg", "job"]])
def test_help_and_configuration_load_nothing_heavy(option: list[str]) -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTED, *option], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_help_names_the_choices(lab: Lab, quick: Path) -> None:
    done = lab("--help")
    assert done.returncode == 0
    for choices in (
        r"finger: .*pneunet",
        r"finger/material: .*ogden, yeoh",
        r"fem: .*quick, .*solid",
        r"task: .*simulate, .*train",
    ):
        assert re.search(f"^{choices}", done.stdout, re.MULTILINE)
    assert "python -m pgdl_lab split=extrapolate" in done.stdout
    assert not (quick.parents[1] / "runs").exists()


def test_configuration_shows_every_value(lab: Lab) -> None:
    done = lab("--cfg", "job", "loss=[data,boundary]", "loss.boundary.weight=2")
    assert done.returncode == 0
    assert "  chambers: 10" in done.stdout
    assert "  boundary:\n    weight: 2.0" in done.stdout
    assert done.stdout.startswith("task: train\nfinger:\n")


@pytest.mark.parametrize(
    ("typed", "answer"),
    [
        ("finger=pneunt", r"There is no finger 'pneunt'\. Did you mean 'pneunet'\? Choices: .*pneunet"),
        ("loss=[dta]", r"There is no loss 'dta'\. Did you mean 'data'\? Choices: .*data, .*navier_cauchy"),
        ("loss=[data,bondary]", r"There is no loss 'bondary'\. Did you mean 'boundary'\?"),
        ("task=trian", r"There is no task 'trian'\. Did you mean 'train'\? Choices: .*train"),
        ("experiment=paper", r"There is no experiment 'paper'\. .*Choices: .*paper_random"),
        ("fingr=pneunet", r"There is no choice or setting 'fingr'\. Did you mean 'finger'\?"),
        ("finger.wal_mm=3", r"There is no finger field 'wal_mm'\. Did you mean 'wall_mm'\? Choices: .*chambers"),
        ("trainer.max_epoch=3", r"There is no trainer field 'max_epoch'\. Did you mean 'max_epochs'\?"),
        (
            "loss.navier_cauchy.weight=3",
            r"The loss 'navier_cauchy' is not chosen: type loss=\[data,navier_cauchy\] too",
        ),
        (
            "finger/material=mooney",
            r"There is no finger/material 'mooney'\. Did you mean .*mooney_rivlin, neo_hooke, ogden, yeoh",
        ),
        ("finger.material.c4_mpa=1", r"There is no finger\.material field 'c4_mpa'\. .*Choices: .*c3_mpa"),
        (
            "finger.material.c10_mpa=0.1",
            r"'c10_mpa' is a field of finger/material=mooney_rivlin, which is not chosen: type that too\.",
        ),
        ("finger.material.c2_mpa=-0.05", r"The material \(c1_mpa=0.11, .*\) softens: .* it must be stable up to 2"),
        ("+finger.walls=3", r"A field was added that does not exist .*'walls'"),
        ("finger.chambers=six", r"finger\.chambers is 'six'; it must be a whole number, such as 4\."),
        ("finger.wall_mm=-3", r"finger\.wall_mm is -3\.0 mm; it must be above 0"),
        ("trainer=fast", r"trainer=fast names no field"),
        ("loss=[]", r"There is no loss to train on"),
        ("seed=x", r"seed is x; it must be a whole number"),
        ("seed=[1", r"'seed=\[1' cannot be read as key=value"),
        ("resume=runs/gone", r"There is no run in 'runs/gone'"),
    ],
)
def test_bad_input_is_one_sentence_before_any_work(lab: Lab, tmp_path: Path, typed: str, answer: str) -> None:
    done = lab(typed)
    assert done.returncode == 1
    assert re.fullmatch(rf"pgdl-lab: .*{answer}.*\n", done.stderr)
    assert {path.name for path in tmp_path.glob("runs/*")} <= {"snapshots"}
    assert not list(tmp_path.glob("mlflow.db"))


def test_a_broken_plugin_warns_and_the_rest_works(lab: Lab, quick: Path) -> None:
    (quick / "broken.py").write_text("1 / 0")
    done = lab("--help")
    assert done.returncode == 0
    assert done.stderr == "Plugin pgdl_lab.plugins.fem.broken is left out: ZeroDivisionError: division by zero\n"
    assert "quick" in done.stdout


@pytest.mark.parametrize(
    ("failure", "answer"),
    [("lab", r"pgdl-lab: The finger burst\.\n"), ("bug", r"pgdl-lab: TypeError: 1 \+ 'a' \(see .*/run\.log\)\n")],
)
def test_a_failure_is_one_line_and_its_traceback_is_in_the_log(
    lab: Lab, tmp_path: Path, quick: Path, failure: str, answer: str
) -> None:
    done = lab("task=simulate", "fem=quick", f"fem.failure={failure}")
    assert done.returncode == 1
    assert re.fullmatch(answer, done.stderr)
    assert "Traceback" not in done.stdout
    (folder,) = run_folders(tmp_path)
    assert "Traceback" in (folder / "run.log").read_text()
    assert not (tmp_path / "runs" / "latest").exists()


def test_a_setting_that_the_simulation_refuses_leaves_no_run(lab: Lab, tmp_path: Path, quick: Path) -> None:
    done = lab("task=simulate", "fem=quick", "fem.failure=input")
    assert done.stderr == "pgdl-lab: fem.failure is 'input'; it must be lab or bug.\n"
    assert run_folders(tmp_path) == [] and not (tmp_path / "runs" / "unfinished").is_symlink()


def test_an_interrupt_is_told(lab: Lab, tmp_path: Path, quick: Path) -> None:
    done = lab("task=simulate", "fem=quick", "fem.failure=interrupt")
    assert done.returncode == 130
    (folder,) = run_folders(tmp_path)
    assert done.stderr == f"\npgdl-lab: stopped; resume={folder} goes on with it\n"


def test_the_other_jobs_of_a_multirun_still_run(lab: Lab, tmp_path: Path, quick: Path) -> None:
    done = lab("-m", "task=simulate", "fem=quick", "fem.failure=lab,bug,input")
    assert done.returncode == 1
    (sweep,) = run_folders(tmp_path)
    assert done.stderr.splitlines()[-4:] == [
        f"pgdl-lab: 3 of the multirun's jobs failed (more in {sweep}/<job>/run.log):",
        "  job 0: The finger burst.",
        "  job 1: TypeError: 1 + 'a'",
        "  job 2: fem.failure is 'input'; it must be lab or bug.",
    ]
    assert "Traceback" not in done.stderr + done.stdout
    for job, error in enumerate(["The finger burst", "TypeError", "InputError"]):
        log = (sweep / str(job) / "run.log").read_text()
        assert "Traceback" in log
        assert error in log


def test_resume_takes_no_multirun(lab: Lab, tmp_path: Path, quick: Path) -> None:
    lab("task=simulate", "fem=quick")
    done = lab("-m", "resume=runs/latest", "seed=1,2")
    assert done.returncode == 1
    assert "resume continues one run: leave out -m" in done.stderr


def test_resume_keeps_the_stored_configuration(lab: Lab, tmp_path: Path, quick: Path) -> None:
    lab("task=simulate", "fem=quick", "seed=7")
    (folder,) = run_folders(tmp_path)
    stored = (folder / "config.yaml").read_text()
    refused = lab("resume=runs/latest", "seed=8")
    assert "'seed' cannot change now" in refused.stderr
    assert (folder / "config.yaml").read_text() == stored
    lab("resume=runs/latest", "trainer.max_epochs=77")
    changed = re.sub(r"max_epochs: \d+", "max_epochs: 77", stored)
    assert (folder / "config.yaml").read_text() == changed != stored
    assert run_folders(tmp_path) == [folder]


@pytest.mark.parametrize("blocked", ["runs", "runs/snapshots"])
def test_an_unwritable_runs_folder_is_told_at_once(lab: Lab, tmp_path: Path, blocked: str) -> None:
    (tmp_path / blocked).parent.mkdir(exist_ok=True)
    (tmp_path / blocked).write_text("a file where a folder is needed")
    done = lab("task=simulate", "finger.chambers=1")
    assert done.returncode == 1
    assert re.fullmatch(rf"pgdl-lab: .*{tmp_path / blocked}.*PGDL_LAB_ROOT.*\n", done.stderr)
    assert "Traceback" not in done.stdout


def test_a_yaml_file_may_extend_a_plugin(lab: Lab, tmp_path: Path, quick: Path) -> None:
    (tmp_path / "variants" / "finger").mkdir(parents=True)
    (tmp_path / "variants" / "finger" / "stout.yaml").write_text("defaults: [pneunet]\nwall_mm: 3.5\n")
    variant = ["--config-dir", str(tmp_path / "variants"), "finger=stout"]
    shown = lab(*variant, "--cfg", "job", "-p", "finger").stdout
    assert "chambers: 10\n" in shown
    assert "wall_mm: 3.5\n" in shown
    refused = lab(*variant, "finger.wall_mm=thin")
    assert "finger.wall_mm is 'thin'; it must be a number, such as 0.5." in refused.stderr
    lab(*variant, "task=simulate", "fem=quick")
    (folder,) = run_folders(tmp_path)
    assert "finger:\n  name: pneunet\n" in (folder / "config.yaml").read_text()
