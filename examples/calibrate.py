"""Choose the dimensions that the paper leaves open, so that a finger's extremes meet those of the paper's FEA.

    python examples/calibrate.py bellows --trials 60
    python -m pgdl_lab task=simulate finger=bellows_calibrated

The search runs on a coarse mesh at the highest pressure only. The best finger is then simulated with the defaults of
`fem=solid`; by how much the two differ is taken off the aim, and a second round goes on from all trials so far. A
search that was stopped goes on where it was: every trial is in runs/calibration/. The result is written to
conf/finger/<finger>_calibrated.yaml, to be typed as any other finger.
"""

import argparse
import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from omegaconf import OmegaConf

from pgdl_lab import cache, paths, registry
from pgdl_lab.assessment.paper import published
from pgdl_lab.errors import LabError
from pgdl_lab.fem import Fem
from pgdl_lab.finger import Finger
from pgdl_lab.snapshots import Observation, Snapshots

STEP_MM = 0.05  # nobody makes a finger more precisely
STARTUP = 6  # random trials before the sampler has a model
FOLDER = paths.RUNS / "calibration"
AT_FULL_PRESSURE = Observation(snapshots=1, points=1500)
DONE = (optuna.trial.TrialState.COMPLETE,)
FAILED = 100.0  # misfit of a finger that does not bear its pressure


@dataclass(frozen=True)
class Search:
    """What of a finger is searched.

    Attributes
    ----------
    open
        Least and greatest value of each open dimension [mm].
    fixed
        Fields with other values than the finger's defaults.
    edge_mm
        Longest element edge of the coarse mesh [mm].
    """

    open: dict[str, tuple[float, float]]
    fixed: dict[str, float]
    edge_mm: float = 4.5


SEARCHES = {
    # Table I: h = 14 mm taken as the inner height of network and channel, to which the roof of 3 mm is added.
    "pneunet": Search(
        open={"root_mm": (2.0, 8.0), "base_mm": (4.75, 6.25), "bridge_mm": (1.75, 2.5), "width_mm": (12.5, 14.0)},
        fixed={"height_mm": 17.0},
    ),
    "joints": Search(
        open={"phalanx_mm": (14.0, 17.0), "tip_mm": (12.0, 18.0), "chamber_height_mm": (6.0, 8.0)},
        fixed={},
    ),
    "bellows": Search(
        open={"width_mm": (18.0, 19.5), "crest_mm": (3.5, 4.5), "base_mm": (2.0, 3.5), "fold_mm": (3.25, 4.25)},
        fixed={},
        edge_mm=12.0,
    ),
}


class Calibration:
    """The search for one finger.

    Parameters
    ----------
    name
        The finger.
    """

    def __init__(self, name: str) -> None:
        self.name, self.search = name, SEARCHES[name]
        self.finger, solid = registry.plugin("finger", name), registry.plugin("fem", "solid")
        self.coarse: Fem = solid(
            edge_mm=self.search.edge_mm, newton_mm=1e-3, interpolation_mm=1.0, estimate_error=False
        )
        self.fine: Fem = solid()
        paper = published(name, "random").fem_mm
        self.target = np.array([paper.get(axis, (np.nan, np.nan)) for axis in "xz"])
        self.tolerance = np.where(np.abs(self.target) > 1, 0.02 * np.abs(self.target), 0.5)
        self.aim = self.target

    def made(self, dimensions: dict[str, float]) -> Finger:
        """The finger with these open dimensions."""
        return self.finger(**self.search.fixed, **{name: round(value, 4) for name, value in dimensions.items()})

    def misfit(self, found: NDArray[np.float64], aim: NDArray[np.float64]) -> float:
        """Root mean square of what the extremes `found` (2, 2) [mm] lack to `aim` (2, 2) [mm], in tolerances."""
        return float(np.sqrt(np.nanmean(((found - aim) / self.tolerance) ** 2)))

    def value(self, found: list[list[float]] | None) -> float:
        """What is minimised; the logarithm lets the model of the sampler see the last tenth as well as the first."""
        return float(np.log10(self.misfit(np.array(found), self.aim) if found else FAILED))

    def __call__(self, trial: optuna.Trial) -> float:
        """Objective of a trial."""
        dimensions = {name: trial.suggest_float(name, *ends, step=STEP_MM) for name, ends in self.search.open.items()}
        try:
            found = extremes(self.coarse.simulate(self.made(dimensions), AT_FULL_PRESSURE)).tolist()
        except LabError as error:
            trial.set_user_attr("stopped", str(error))
            found = None
        trial.set_user_attr("extremes_mm", found)
        return self.value(found)

    def study(self, number: int) -> optuna.Study:
        """The study of a round, as far as it has come."""
        what = repr((self.search, self.made(self.start()), self.coarse, self.target.tolist()))
        FOLDER.mkdir(parents=True, exist_ok=True)
        log = optuna.storages.journal.JournalFileBackend(str(FOLDER / f"{self.name}.journal"))
        sampler = optuna.samplers.GPSampler(seed=number, n_startup_trials=STARTUP)
        return optuna.create_study(
            study_name=f"{hashlib.sha256(what.encode()).hexdigest()[:8]}-{number}",
            storage=optuna.storages.JournalStorage(log),
            sampler=sampler,
            load_if_exists=True,
        )

    def run(self, trials: int, rounds: int) -> tuple[Finger, str]:
        """Search `rounds` times with `trials` new trials each; the best by the fine mesh, and what it does."""
        verdicts: list[tuple[float, Finger, str]] = []
        earlier: list[optuna.trial.FrozenTrial] = []
        for number in range(rounds):
            study = self.study(number)
            if not study.trials and earlier:
                study.add_trials([self.revalued(trial) for trial in earlier])
            elif not study.trials:
                study.enqueue_trial(self.start())
            left = trials + len(earlier) - len(study.get_trials(states=DONE))
            study.optimize(self, n_trials=max(0, left), show_progress_bar=True)
            earlier = study.get_trials(states=DONE)

            best = study.best_trial
            made = self.made(best.params)
            snapshots, _, _ = cache.simulate(made, self.fine, Observation(), paths.RUNS / "snapshots")
            fine = extremes(snapshots)
            said = [f"u_{axis} {low:.3f} … {high:.3f} mm" for axis, (low, high) in zip("xz", fine, strict=True)]
            verdicts.append((self.misfit(fine, self.target), made, ", ".join(said)))
            print(f"round {number}: {verdicts[-1][2]}; misfit {verdicts[-1][0]:.2f} tolerances")
            self.aim = self.target + np.array(best.user_attrs["extremes_mm"]) - fine
        return min(verdicts, key=lambda verdict: verdict[0])[1:]

    def start(self) -> dict[str, float]:
        """The middle of the ranges."""
        return {name: round((low + high) / 2 / STEP_MM) * STEP_MM for name, (low, high) in self.search.open.items()}

    def revalued(self, trial: optuna.trial.FrozenTrial) -> optuna.trial.FrozenTrial:
        """An earlier trial, judged by the present aim."""
        return optuna.trial.create_trial(
            params=trial.params,
            distributions=trial.distributions,
            user_attrs=trial.user_attrs,
            value=self.value(trial.user_attrs["extremes_mm"]),
        )


def extremes(snapshots: Snapshots) -> NDArray[np.float64]:
    """Least and greatest u_x and u_z at the highest pressure (2, 2) [mm]."""
    last = snapshots.displacements[-1]
    return np.column_stack([last.min(axis=0), last.max(axis=0)])


def main() -> None:
    """Search and write the variant."""
    parser = argparse.ArgumentParser(description="Calibrate a finger to the paper's extremes.")
    parser.add_argument("finger", choices=SEARCHES)
    parser.add_argument("--trials", type=int, default=60, help="new trials of each round")
    parser.add_argument("--rounds", type=int, default=2, help="how often the coarse mesh is held against the fine one")
    chosen = parser.parse_args()
    registry.discover()
    calibration = Calibration(chosen.finger)
    best, said = calibration.run(chosen.trials, chosen.rounds)
    names = [*calibration.search.fixed, *calibration.search.open]
    variant: dict[str, Any] = {"defaults": [chosen.finger], **{name: getattr(best, name) for name in names}}
    path = paths.CONF / "finger" / f"{chosen.finger}_calibrated.yaml"
    head = f"# Written by `python examples/calibrate.py {chosen.finger} --trials {chosen.trials}`: {said}.\n"
    path.write_text(head + OmegaConf.to_yaml(OmegaConf.create(variant)), encoding="utf-8")
    print(f"{path}:\n{path.read_text(encoding='utf-8')}")


if __name__ == "__main__":
    main()
