"""What physics in the loss is worth: each term at several weights against data alone, on both splits and on few points.

    python benchmarks/physics_ablation.py [--seconds 600] [--seeds 0 1]

Trains `model=body` (64 modes, 2 × 64, degree 5) on a finger of 4 chambers for the same number of steps whatever the
loss; a term costs time on top. Nothing is set aside and the last state counts, whatever it is: a guard that keeps a
better one would hide the harm that a term does. A weight is given as the error that it is worth: at `r` mm the term
counts on the simulated displacement itself, on its floor, as much as data that err by r mm RMS. Each result is kept
under runs/physics_ablation, where a later call goes on, for so many seconds (default: until all are done) and with some
of the seeds (default: all); then the table is printed and the figure drawn. All of it takes a quarter of an hour on one
core.
"""

import itertools
import math
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import common
from benchmarks.scenes import simulated
from pgdl_lab.assessment.residuals import residuals
from pgdl_lab.core import registry
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.observation import Observation
from pgdl_lab.learning import left_out
from pgdl_lab.learning.loss import Loss
from pgdl_lab.learning.module import TrainingDiverged
from pgdl_lab.learning.scene import Scene
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
from pgdl_lab.running.experiment import Experiment

CHAMBERS, BATCH = 4, 128
SEEDS = range(5)
SPLITS = ("random", "extrapolate")
SHARES = (0.05, 0.01, 0.002)
WORTHS_MM = (0.01, 0.1)
TERMS: dict[str, tuple[str, dict[str, Any]]] = {
    "published": ("navier_cauchy", {"form": "published"}),
    "corrected": ("navier_cauchy", {"form": "corrected"}),
    "yeoh": ("yeoh", {}),
    "section": ("section", {}),
    "traction": ("traction", {}),
}
RATIOS = (0.25, 0.5, 1, 2)  # that the axes of the figure show
FAILED_MM = 10.0  # RMS error from which a training counts as failed


@dataclass(frozen=True)
class Case:
    """One training."""

    seed: int
    split: str
    share: float
    term: str
    worth_mm: float


@dataclass(frozen=True)
class Setting:
    """What all trainings share.

    Attributes
    ----------
    made
        Finger, finite elements and observation, simulated as `snapshots`.
    steps
        Of the optimiser.
    found
        Of each term: what it makes of the simulated displacement, "fem", and of none, "rest".
    """

    made: Experiment
    snapshots: Dataset
    steps: int
    found: dict[str, dict[str, float]]

    @classmethod
    def of(cls, quick: bool) -> "Setting":
        """The one of the page, or a small one."""
        registry.discover()
        made = Experiment.of(
            finger=registry.plugin("finger", "pneunet")(chambers=2 if quick else CHAMBERS),
            fem=registry.plugin("fem", "solid")(edge_mm=6.0 if quick else 3.0, estimate_error=False),
            observation=Observation(snapshots=50, points=400 if quick else 1000),
        )
        snapshots, losses = simulated(made), {term: made_of(term, 1.0)[term] for term in TERMS}
        nothing, some = 0 * snapshots.displacements, np.arange(4, 44, 5)
        found = residuals(losses, Scene.of(made.finger, snapshots), snapshots, nothing, some)
        return cls(made, snapshots, 20 if quick else 500, found)


def cases(seeds: Iterable[int], quick: bool) -> Iterator[Case]:
    """All trainings, seed by seed, so that a broken-off series has as many of each; for a quick run few."""
    few = 1 if quick else None
    for seed, split, share in itertools.product(seeds, SPLITS, SHARES[:few]):
        yield Case(seed, split, share, "none", 0.0)
        yield from (Case(seed, split, share, term, worth) for term in TERMS for worth in WORTHS_MM[:few])


def made_of(term: str, weight: float) -> dict[str, Loss]:
    """The losses of a case."""
    data = {"data": registry.plugin("loss", "data")(), "boundary": registry.plugin("loss", "boundary")()}
    if term == "none":
        return data
    name, fields = TERMS[term]
    return {**data, term: registry.plugin("loss", name)(weight=weight, **fields)}


def train(case: Case, setting: Setting, reach_kpa: float | None = None) -> dict[str, Any]:
    """Errors of one training: RMS over unseen points at pressures up to the cut-off and beyond it [mm].

    Terms of physics are visited up to `reach_kpa`, by default all pressures [kPa].
    """
    snapshots = setting.snapshots
    split = registry.plugin("split", case.split)(points=round(case.share * snapshots.displacements[..., 0].size))
    points = split.train_points(snapshots, case.seed)
    weight = case.worth_mm**2 / setting.found[case.term]["fem"] if case.term in setting.found else 0.0
    epochs = math.ceil(setting.steps / math.ceil(len(points) / BATCH))
    made = replace(
        setting.made,
        model=registry.plugin("model", "body")(modes=64, depth=2, width=64),
        loss=made_of(case.term, weight),
        trainer=TrainerSettings(
            max_time="600", max_epochs=epochs, accelerator="cpu", validation=0.0, progress=False, log_every_s=1e9
        ),
        optimizer=OptimizerSettings(lr=2e-3, batch_size=BATCH),
        seed=case.seed,
    )
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        training = made.training(snapshots, points, Path(folder))
        if reach_kpa is not None:
            training = replace(training, scene=replace(training.scene, max_kpa=reach_kpa))
        try:
            surrogate = made.model.fit(training)
        except TrainingDiverged:
            return {**asdict(case), "failed": True}
    history = surrogate.record.history[-1]
    seconds = time.perf_counter() - start
    error = surrogate.predict(snapshots.domain.points_mm, snapshots.pressures_kpa) - snapshots.displacements
    square = (error**2).sum(axis=2)
    square.flat[points] = np.nan
    beyond = snapshots.pressures_kpa > 44
    within_mm, beyond_mm = (float(np.sqrt(np.nanmean(square[which]))) for which in (~beyond, beyond))
    return {
        **asdict(case),
        "failed": not max(within_mm, beyond_mm) < FAILED_MM,
        "within_mm": within_mm,
        "beyond_mm": beyond_mm,
        "gradient_share": history.get(f"share/{case.term}"),
        "seconds": seconds,
    }


Panel = tuple[str, str, str]
PANELS: tuple[Panel, ...] = (
    ("random", "within_mm", "split random, up to 44 kPa"),
    ("extrapolate", "within_mm", "split extrapolate, up to 44 kPa"),
    ("extrapolate", "beyond_mm", "split extrapolate, above 44 kPa"),
)


def ratios(results: list[dict[str, Any]], split: str, error: str, share: float, term: str, worth: float) -> list[float]:
    """Error by that of data alone, seed by seed, of trainings that did not fail."""
    by_case = {Case(**{key: row[key] for key in Case.__dataclass_fields__}): row for row in results}
    found = []
    for seed in SEEDS:
        ours = by_case.get(Case(seed, split, share, term, worth))
        alone = by_case.get(Case(seed, split, share, "none", 0.0))
        if ours and alone and not ours["failed"] and not alone["failed"]:
            found.append(ours[error] / alone[error])
    return found


def geometric_mean(values: Sequence[float]) -> float:
    """Of ratios."""
    return math.exp(np.mean(np.log(values)))


def table(results: list[dict[str, Any]]) -> Table:
    """Ratio to data alone: geometric mean, least and greatest; counts of trainings and failures."""
    title = "RMS error by that of data alone: geometric mean (least … greatest) over seeds"
    headings = ("term", "worth [mm]", "points", *(title for *_, title in PANELS), "runs", "failed")
    shown = common.table(title, headings, left=0)
    for share in SHARES:
        alone = [row for row in results if row["term"] == "none" and row["share"] == share and not row["failed"]]
        cells = []
        for split, error, _ in PANELS:
            values = [row[error] for row in alone if row["split"] == split]
            cells.append(f"{common.spread(values)} mm" if values else "–")
        shown.add_row("data alone", "–", f"{share:.1%}", *cells, str(len(alone)), "")
        for term, worth in itertools.product(TERMS, WORTHS_MM):
            rows = [r for r in results if (r["term"], r["worth_mm"], r["share"]) == (term, worth, share)]
            cells = []
            for split, error, _ in PANELS:
                values = ratios(results, split, error, share, term, worth)
                cells.append(common.spread(values, geometric_mean, ".2f") if values else "–")
            failed = sum(row["failed"] for row in rows)
            shown.add_row(term, f"{worth:g}", f"{share:.1%}", *cells, str(len(rows)), str(failed))
        shown.add_section()
    return shown


def draw(results: list[dict[str, Any]], path: Path) -> None:
    """The ratios as a figure."""
    from matplotlib.ticker import NullFormatter

    figure, axes = common.panels(3, 1, (13, 10), sharex=True, sharey=True)
    places = list(itertools.product(TERMS, WORTHS_MM))
    for ax, (split, error, title) in zip(axes, PANELS, strict=True):
        for shift, share, colour in zip((-0.2, 0, 0.2), SHARES, ("C0", "C1", "C3"), strict=True):
            for place, (term, worth) in enumerate(places):
                values = ratios(results, split, error, share, term, worth)
                if values:
                    mean = geometric_mean(values)
                    ax.plot([place + shift] * 2, [min(values), max(values)], color=colour, lw=1.5)
                    ax.plot(place + shift, mean, "o", color=colour, ms=4)
        for share, colour in zip(SHARES, ("C0", "C1", "C3"), strict=True):
            alone = [r[error] for r in results if (r["term"], r["split"], r["share"]) == ("none", split, share)]
            mean_mm = f"{np.mean(alone):.2g} mm" if alone else "–"
            ax.plot([], [], "o-", color=colour, ms=4, label=f"{share:.1%} of the points; data alone {mean_mm}")
        ax.axhline(1, color="0.4", lw=1)
        for place in range(len(WORTHS_MM), len(places), len(WORTHS_MM)):
            ax.axvline(place - 0.5, color="0.85", lw=1)
        ax.set(yscale="log", title=title, ylabel="RMS error by that\nof data alone", xlim=(-0.5, len(places) - 0.5))
        ax.set_yticks(RATIOS, [f"{ratio:g}" for ratio in RATIOS])
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.grid(axis="y", color="0.92")
        ax.legend(loc="lower left", fontsize=8)
    axes[-1].set_xticks(range(len(places)), [f"{term}\n{worth:g} mm" for term, worth in places], fontsize=8)
    axes[-1].set_xlabel("term and its weight, as the error that it is worth on the simulated displacement")
    title = f"Physics in the loss of model body on a finger of {CHAMBERS} chambers, {len(results)} trainings"
    figure.suptitle(f"{title}; dots: mean, bars: all seeds")
    common.save(figure, path, dpi=110)


def main() -> None:
    """Train what is missing, print and draw."""
    left_out.FEW = 0  # error bars of few points take five trainings more, and nobody asks for them here
    arguments = common.parser(__doc__)
    arguments.add_argument("--seconds", type=float, default=math.inf, help="begin no training after that time")
    arguments.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    given = common.parsed(arguments, seeds=[0])
    deadline, setting = time.monotonic() + given.seconds, Setting.of(given.quick)
    store, docs = common.folders("physics_ablation", given.quick)

    def found(case: Case, deadline: float) -> dict[str, Any] | None:
        name = common.digest([CHAMBERS, BATCH, setting.steps, asdict(case)])
        return common.kept(store / f"{name}.json", partial(train, case, setting), deadline)

    for case in cases(given.seeds, given.quick):
        found(case, deadline)
    everything = [found(case, -math.inf) for case in cases(SEEDS, given.quick)]  # with those of calls beside this one
    results = [result for result in everything if result is not None]
    headings = ("term", "simulated displacement (floor)", "no displacement")
    shown = common.table("Terms of whole fields, unweighted, mean over 5 … 40 kPa", headings, left=0)
    for term, values in setting.found.items():
        shown.add_row(term, f"{values['fem']:.3g}", f"{values['rest']:.3g}")
    common.show(shown, table(results))
    costs = [
        (term, [r["seconds"] for r in results if r["term"] == term and "seconds" in r]) for term in ("none", *TERMS)
    ]
    print("seconds per training:", ", ".join(f"{term} {np.median(took):.1f}" for term, took in costs if took))
    if results:
        draw(results, docs / "figures" / "physics_ablation.png")


if __name__ == "__main__":
    main()
