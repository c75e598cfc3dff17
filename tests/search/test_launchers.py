"""Searches whose trials Hydra's launchers run; each launcher is a package of its own."""

from pathlib import Path

import pytest
from optuna.trial import TrialState

from tests.conftest import Lab
from tests.needs import EXTRAS, need
from tests.search.toy import SEARCH, make_toy, trials

LAUNCHERS = {
    "joblib": ("hydra_plugins.hydra_joblib_launcher", ["hydra.launcher.n_jobs=2"]),
    "submitit_local": ("hydra_plugins.hydra_submitit_launcher", ["hydra.launcher.timeout_min=2"]),
    "ray": ("hydra_plugins.hydra_ray_launcher", ["+hydra.launcher.ray.init.num_cpus=2"]),
}


@pytest.mark.parametrize("name", LAUNCHERS)
def test_a_launcher_runs_the_trials_of_a_batch(lab: Lab, tmp_path: Path, migrated_database: Path, name: str) -> None:
    package, settings = LAUNCHERS[name]
    if package in EXTRAS:
        need(package)
    make_toy(tmp_path, migrated_database)
    typed = (*SEARCH, "fem.a=interval(0,1)", "hydra.sweeper.n_trials=2", "hydra.sweeper.batch=2")
    done = lab(*typed, f"hydra/launcher={name}", *settings)
    assert done.returncode == 0, done.stdout + done.stderr
    found = trials(tmp_path)
    assert [trial.state for trial in found] == [TrialState.COMPLETE] * 2
    assert len({trial.params["fem.a"] for trial in found}) == 2
