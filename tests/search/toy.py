"""A body that is computed in no time, for searches in processes of their own."""

import shutil
from pathlib import Path

import optuna
from optuna.trial import FrozenTrial

from pgdl_lab.search.storage import open_storage

TOY = '''
import time
from dataclasses import dataclass
import numpy as np
from pgdl_lab.core.errors import LabError
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.core.registry import register
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.domain import Domain
from tests.synthetic import snapshots

@register("fem", "toy")
@dataclass(frozen=True)
class Toy(Fem):
    """Three points, or a body to train on."""
    a: float = 0.5
    b: float = 0.5
    kind: str = "points"
    wait_s: float = 0.0

    def simulate(self, finger, observation):
        if self.kind == "burst":
            raise LabError("The finger burst.")
        time.sleep(60 if self.kind == "slow" else self.wait_s)
        if self.kind == "body":
            return snapshots(cell_mm=2.5, count=3)
        u = np.zeros((1, 3, 2))
        u[0, 1] = (self.a - 0.3) ** 2, self.b * (1 + self.a)
        return Dataset.path(Domain(np.eye(3, 2), np.array([[0, 1, 2]])), np.ones(1), u)
'''
SEARCH = ("-m", "sweep=search", "task=simulate", "fem=toy", "hydra.sweeper.objectives=[extremes_mm.fem.x.1]")


def make_toy(root: Path, database: Path) -> Path:
    """Give a root the plugin `fem=toy` and an empty database."""
    (root / "plugins" / "fem").mkdir(parents=True)
    (root / "plugins" / "fem" / "toy.py").write_text(TOY)
    shutil.copy(database, root / "mlflow.db")
    return root


def trials(root: Path, study: str = "search") -> list[FrozenTrial]:
    folder = root / "runs" / study
    if not (folder / "study.journal").exists():
        return []
    storage = open_storage(None, folder)
    names = [summary.study_name for summary in optuna.get_all_study_summaries(storage)]
    return optuna.load_study(study_name=study, storage=storage).trials if names else []
