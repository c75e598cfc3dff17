"""Every model on every finger and split: errors, training time, latency and failures in one table and one figure.

    python benchmarks/comparison.py                      # all of it: hours on two cores
    python benchmarks/comparison.py --quick              # one seed of a small pneunet, short budgets
    python benchmarks/comparison.py --finger pneunet --split random --model pod --model hybrid

Each trial is stored under runs/comparison as soon as it ends; one that is found there is not run again, so that a
broken comparison goes on where it was and the table can be made of what there is (--only-found); --markdown writes it
to docs/comparison.md. The paper's network and protocol get the wall time of the default model, and beside it the times
in BUDGETS_S; the network `body` its own budget, and LONGER_S with decaying weights and fewer points set aside, as it
would learn the training points by heart. Medians are over seeds. The figure is docs/figures/surrogates.png.
"""

import math
from dataclasses import asdict, dataclass
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import common, scenes
from pgdl_lab.assessment.comparison import Comparison
from pgdl_lab.assessment.latency import latency_ms
from pgdl_lab.core import registry
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.running.experiment import Experiment

SPLITS, SEEDS = ("random", "extrapolate", "snapshots"), (0, 1, 2)
PAPER, DEFAULT, NETWORK = "paper", "hybrid", "body"
LONGER_S = 240.0  # of `body`
BUDGETS_S = (10.0, 30.0, 100.0, LONGER_S)  # of the paper's protocol, beside the wall time of the default
DECAYING = ("optimizer.name=adamw", "optimizer.weight_decay=0.003", "trainer.validation=0.02")
ENDLESS = 1_000_000  # epochs, so that the time ends a training


@dataclass(frozen=True)
class Trial:
    """One training: its choices, and a wall time if it is not the model's own budget."""

    finger: str
    split: str
    model: str
    seed: int
    budget_s: float | None = None

    def experiment(self, quick: bool) -> Experiment:
        """What is run."""
        choices = [f"split={self.split}", f"seed={self.seed}"]
        choices += ["experiment=paper_printed"] if self.model == PAPER else [f"model={self.model}"]
        if self.model == NETWORK and self.budget_s is not None:
            choices += DECAYING
        if self.budget_s is not None:
            choices += [f"trainer.max_time={self.budget_s:g}", f"trainer.max_epochs={ENDLESS}"]
        return scenes.scene(self.finger, *choices, quick=quick)


@dataclass(frozen=True)
class Store:
    """Where trials are kept; whether they are small ones, and whether what is not there is run."""

    folder: Path
    quick: bool
    only_found: bool

    def result(self, trial: Trial) -> dict[str, Any] | None:
        """What a trial shows: from the disk if it was run before, None if it was not and only what is there counts."""
        made = trial.experiment(self.quick)
        parts = [made.finger, made.fem, made.model, made.split, *made.loss.values()]
        settings = {
            "trial": asdict(trial), "parts": [registry.describe(part) for part in parts],
            "rule": asdict(made.optimizer), "budget": asdict(made.trainer),
        }  # fmt: skip
        name = f"{trial.finger}-{trial.split}-{trial.model}-{trial.seed}-{common.digest(settings)}.json"
        never = -math.inf if self.only_found else math.inf
        return common.kept(self.folder / name, lambda: {**settings, **run(made)}, never)

    def row(self, finger: str, split: str, label: str, trials: list[Trial]) -> "Row":
        """A line of the table."""
        return Row(finger, split, label, [found for trial in trials if (found := self.result(trial)) is not None])


def run(made: Experiment) -> dict[str, Any]:
    """Train and measure; a training that breaks down is a result too."""
    snapshots = scenes.simulated(made)
    train = made.split.train_points(snapshots, made.seed)
    try:
        surrogate, seconds = scenes.fitted(made, snapshots, train)
    except LabError as error:
        return {"failed": str(error)}
    surrogate.outside = "ignore"
    asked = snapshots.domain.points_mm, snapshots.pressures_kpa
    comparison = Comparison(snapshots, surrogate.predict(*asked), train, surrogate.error_bar(*asked))
    extremes = comparison.extremes_mm()
    tip, highest = int(snapshots.domain.base[-1]), float(snapshots.pressures_kpa[-1])
    mse_mm2 = comparison.mse_mm2()
    if not np.isfinite(list(mse_mm2.values())).all():
        return {"failed": "the error is not finite"}
    return {
        "seconds": seconds,
        "mse_mm2": mse_mm2,
        "error_bar": comparison.error_bar(),
        "highlights": [comparison.by_pressure()[i] for i in made.split.highlights(snapshots.cases)],
        "extremes_mm": max(
            abs(ours - theirs)
            for axis in "xz"
            for ours, theirs in zip(extremes["surrogate"][axis], extremes["fem"][axis], strict=True)
        ),
        "latency_ms": latency_ms(surrogate, snapshots.domain.points_mm, tip, highest),
    }


@dataclass(frozen=True)
class Row:
    """Medians over the seeds of one line of the table."""

    finger: str
    split: str
    label: str
    results: list[dict[str, Any]]

    @property
    def good(self) -> list[dict[str, Any]]:
        """Results of the trainings that came through."""
        return [result for result in self.results if "failed" not in result]

    def median(self, *keys: str) -> float:
        """Median of the number that lies under `keys`."""
        values: list[Any] = [reduce(getitem, keys, result) for result in self.good]
        return float(np.median(values)) if values else float("nan")

    def worst(self, axis: str) -> float:
        """Median over the seeds of the greatest MSE among the highlighted pressures [mm²]."""
        found = [max(row[f"mse_{axis}_mm2"] for row in result["highlights"]) for result in self.good]
        return float(np.median(found)) if found else float("nan")

    def covered(self) -> tuple[float, float]:
        """Medians over the seeds of the share of errors in the error bar: over all, and the least of the highlights."""
        bars = [result for result in self.good if result["error_bar"]]
        if not bars:
            return float("nan"), float("nan")
        everywhere = [(each["error_bar"]["covered_x"] + each["error_bar"]["covered_z"]) / 2 for each in bars]
        least = [min(row["covered"] for row in each["highlights"]) for each in bars]
        return float(np.median(everywhere)), float(np.median(least))


def rows(store: Store, fingers: list[str], splits: list[str], models: list[str], seeds: list[int],
         budgets: list[float], longer: list[float]) -> list[Row]:  # fmt: skip
    """All lines of the table, running what has not been run."""
    lines = []
    for finger in fingers:
        for split in splits:
            ours = float("nan")
            for model in [name for name in models if name != PAPER]:
                line = store.row(finger, split, model, [Trial(finger, split, model, seed) for seed in seeds])
                lines.append(line)
                ours = line.median("seconds") if model == DEFAULT and line.good else ours
                for budget in longer if model == NETWORK and split == "random" else []:
                    trials = [Trial(finger, split, model, seed, budget) for seed in seeds]
                    lines.append(store.row(finger, split, f"{model}, {budget:g} s, decay", trials))
            same = [float(np.ceil(ours))] if np.isfinite(ours) else []
            for budget in ([*same, *budgets] if split == "random" else same) if PAPER in models else []:
                trials = [Trial(finger, split, PAPER, seed, budget) for seed in seeds]
                lines.append(store.row(finger, split, f"{PAPER}, {budget:g} s", trials))
    return [line for line in lines if line.results]


HEADINGS = (
    "finger", "split", "model", "seeds", "failed", "MSE x mm²", "MSE z mm²", "highlights x", "highlights z",
    "extremes mm", "in bar", "highlights in bar", "train s", "field ms (p99)", "tip ms (p99)",
)  # fmt: skip


def cells(line: Row) -> list[str]:
    """A line of the table."""
    latency = (
        f"{line.median('latency_ms', what, 'median'):.3g} ({line.median('latency_ms', what, 'p99'):.3g})"
        for what in ("full_field", "tip")
    )
    covered = ("–" if np.isnan(share) else f"{share:.0%}" for share in line.covered())
    return [
        line.finger, line.split, line.label, str(len(line.results)), str(len(line.results) - len(line.good)),
        f"{line.median('mse_mm2', 'x'):.1e}", f"{line.median('mse_mm2', 'z'):.1e}", f"{line.worst('x'):.1e}",
        f"{line.worst('z'):.1e}", f"{line.median('extremes_mm'):.1e}", *covered, f"{line.median('seconds'):.1f}",
        *latency,
    ]  # fmt: skip


def table(lines: list[Row]) -> Table:
    """The comparison as a table."""
    shown = common.table("Medians over seeds; errors over unseen points; latency on one thread", HEADINGS, left=3)
    for line in lines:
        shown.add_row(*cells(line))
    return shown


def write_page(lines: list[Row], path: Path) -> None:
    """The comparison as a Markdown page."""
    content = [
        "# Every surrogate on every finger and split", "",
        "Made by `python benchmarks/comparison.py --only-found --markdown` from the trials that were run. Medians over",
        "the seeds; errors over all points not trained on. Highlights are the pressures that the split is judged at,",
        "for `extrapolate` those beyond the trained ones; of them the worst is given. Latency on one thread, with the",
        "99th percentile.", "",
        f"| {' | '.join(HEADINGS)} |", "|" + " --- |" * len(HEADINGS),
        *(f"| {' | '.join(cells(line))} |" for line in lines), "",
    ]  # fmt: skip
    with replacing(path) as temporary:
        temporary.write_text("\n".join(content), encoding="utf-8")
    print(f"Page: {path}")


def draw(lines: list[Row], path: Path) -> None:
    """Error against training time and against latency, random split."""
    lines = [line for line in lines if line.split == "random" and line.good]
    if not lines:
        return
    models = list(dict.fromkeys(line.label.split(",")[0] for line in lines))
    fingers = list(dict.fromkeys(line.finger for line in lines))
    figure, axes = common.panels(1, 2, (9, 3.9), sharey=True)
    for line in lines:
        model = line.label.split(",")[0]
        style: dict[str, Any] = {
            "color": f"C{models.index(model)}", "marker": "osD^v"[fingers.index(line.finger)], "ls": "none", "ms": 6,
            "mec": "white", "mew": 0.5,
        }  # fmt: skip
        mse = line.median("mse_mm2", "x") + line.median("mse_mm2", "z")
        axes[0].plot(line.median("seconds"), mse, **style)
        axes[1].plot(line.median("latency_ms", "full_field", "median"), mse, **style)
    for finger in fingers:
        curve = sorted((row.median("seconds"), row.median("mse_mm2", "x") + row.median("mse_mm2", "z"))
                       for row in lines if row.finger == finger and row.label.startswith(PAPER))  # fmt: skip
        if curve:
            axes[0].plot(*zip(*curve, strict=True), color=f"C{models.index(PAPER)}", lw=1, zorder=1)
    for model in models:
        axes[1].plot([], [], "o", color=f"C{models.index(model)}", label=model)
    for finger in fingers if len(fingers) > 1 else []:
        axes[1].plot([], [], "osD^v"[fingers.index(finger)], color="0.4", label=finger)
    for panel, label in zip(axes, ("training time (s)", "latency of the full field (ms)"), strict=True):
        panel.set(xscale="log", yscale="log", xlabel=label)
        panel.grid(alpha=0.3, which="major")
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("MSE over unseen points, x + z (mm²)")
    figure.legend(loc="outside right center", frameon=False)
    common.save(figure, path, dpi=180)


def main() -> None:
    """Run what is missing, print the table, draw the figure."""
    registry.discover()
    names = [*registry.names("model"), PAPER]
    arguments = common.parser(__doc__)
    arguments.add_argument("--finger", action="append", choices=scenes.FINGERS)
    arguments.add_argument("--split", action="append", choices=SPLITS)
    arguments.add_argument("--model", action="append", choices=names)
    arguments.add_argument("--seed", action="append", type=int)
    arguments.add_argument("--budget", action="append", type=float, help="seconds of the paper's protocol")
    arguments.add_argument("--markdown", action="store_true", help="write docs/comparison.md")
    arguments.add_argument("--only-found", action="store_true", help="table and figure of what was run before")
    given = common.parsed(arguments)
    few = 1 if given.quick else None
    folder, docs = common.folders("comparison", given.quick)
    lines = rows(
        Store(folder, given.quick, given.only_found),
        given.finger or list(scenes.FINGERS[:few]),
        given.split or list(SPLITS[:few]),
        given.model or names,
        given.seed or list(SEEDS[:few]),
        given.budget or ([2.0] if given.quick else list(BUDGETS_S)),
        [] if given.quick else [LONGER_S],
    )
    common.show(table(lines))
    if given.markdown:
        write_page(lines, docs / "comparison.md")
    draw(lines, docs / "figures" / "surrogates.png")


if __name__ == "__main__":
    main()
