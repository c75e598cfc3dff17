"""The tables of the paper, and the numbers of its figures, with ours beside them.

    python benchmarks/paper.py [CHOICE …]

Runs `python -m pgdl_lab` for each finger and split that the paper reports, with the CHOICEs that are typed behind (such
as `model=body`), and prints docs/paper.md's tables in Markdown. Minutes, the simulations included.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.common import folders, parsed, parser
from benchmarks.scenes import COARSE, SMALL
from pgdl_lab.assessment.paper import PUBLISHED, published
from pgdl_lab.core import paths

Metrics = dict[str, Any]


def main() -> None:
    """Run what the paper ran, and print the tables."""
    arguments = parser(__doc__)
    arguments.add_argument("choices", nargs="*", metavar="CHOICE")
    given = parsed(arguments)
    root, scenes = (folders("paper", True)[0], list(PUBLISHED)[:1]) if given.quick else (paths.ROOT, list(PUBLISHED))
    runs = {
        (finger, split): run(root, finger, split, (SMALL[finger] + COARSE if given.quick else []) + given.choices)
        for finger, split in scenes
    }
    for (finger, split), metrics in runs.items():
        heading = f"{finger}, {split}: MSE over the points not trained on (mm²)"
        errors(heading, metrics, published(finger, split).mse_mm2)
    extremes({finger: metrics for (finger, split), metrics in runs.items() if split == "random"})
    base_lines([metrics for (finger, _), metrics in runs.items() if finger == "pneunet"])


def run(root: Path, finger: str, split: str, choices: list[str]) -> Metrics:
    """The metrics.json of a training whose folder lies under `root`."""
    command = [sys.executable, "-m", "pgdl_lab", f"finger={finger}", f"split={split}", *choices]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "PGDL_LAB_ROOT": str(root)})
    found: Metrics = json.loads((root / "runs" / "latest" / "metrics.json").read_text(encoding="utf-8"))
    return found


def table(title: str, headings: list[str], rows: list[list[str]]) -> None:
    """Print a table in Markdown."""
    lines = [headings, ["---"] * len(headings), *rows]
    print(f"\n**{title}**\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines), flush=True)


def errors(title: str, metrics: Metrics, theirs: dict[float, tuple[str, str]]) -> None:
    """Mean squared errors at the pressures that the paper names (Fig. 7 and Table II)."""
    rows = []
    for share, (x, z) in theirs.items():
        row = at(metrics["by_pressure"], share)
        rows.append([f"{row['kpa']:g} kPa", x, f"{row['mse_x_mm2']:.1e}", z, f"{row['mse_z_mm2']:.1e}"])
    all_of = metrics["mse_mm2"]
    rows.append(["all", "", f"{all_of['x']:.1e}", "", f"{all_of['z']:.1e}"])
    table(title, ["", "x, the paper", "x, ours", "z, the paper", "z, ours"], rows)


def extremes(of: dict[str, Metrics]) -> None:
    """Least and greatest displacements at the highest pressure (Figs. 4 and 5)."""

    def text(pair: Any) -> str:
        return "{:.2f} … {:.2f}".format(*pair).replace("-", "−") if pair else "–"

    rows = []
    for finger, metrics in of.items():
        paper, ours = published(finger, "random"), metrics["extremes_mm"]
        for axis in "xz":
            rows.append([f"{finger}, u_{axis}", text(paper.fem_mm.get(axis)), text(ours["fem"][axis]),
                         text(paper.surrogate_mm.get(axis)), text(ours["surrogate"][axis])])  # fmt: skip
    title = "Least and greatest displacement at the highest pressure (mm)"
    table(title, ["", "the paper's FEA", "our FEM", "the paper's PGDL", "our surrogate"], rows)


def base_lines(of: list[Metrics]) -> None:
    """Mean curvatures of the base line, and the distance between the two (Figs. 6 and 8, which give no numbers)."""
    rows = []
    for metrics in of:
        for share in published(metrics["finger"], metrics["split"]).mse_mm2:
            row = at(metrics["curvature"], share)
            curvatures = (f"{row[f'{who}_per_m']:.3f}".replace("-", "−") for who in ("fem", "surrogate"))
            rows.append([f"{metrics['split']}, {row['kpa']:g} kPa", *curvatures, f"{row['rms_distance_mm']:.1e}"])
    headings = ["pneunet", "FEM (1/m)", "surrogate (1/m)", "distance of the base lines, rms (mm)"]
    table("Mean curvature of the base line", headings, rows)


def at(rows: list[Metrics], share: float) -> Metrics:
    """The row at a share of the highest pressure."""
    return min(rows, key=lambda row: abs(row["kpa"] / rows[-1]["kpa"] - share))


if __name__ == "__main__":
    main()
