"""The small scene whose chart guards against methods that get worse.

`python -m tests.studies.chart.scene` measures it and writes its errors to stored.json beside this file; do so only when
an error has grown for a reason.
"""

import json
from dataclasses import replace
from pathlib import Path

from pgdl_lab.assessment import latency
from pgdl_lab.core.observation import Observation
from pgdl_lab.running.composing import experiment
from pgdl_lab.studies.chart.bench import Bench
from pgdl_lab.studies.chart.methods import all_points
from pgdl_lab.studies.chart.point import Point
from pgdl_lab.studies.chart.settings import ChartSettings
from tests.fingers import pneunet, solid

STORED = Path(__file__).with_name("stored.json")
SETTINGS = ChartSettings(
    reference={"name": "solid", "edge_mm": 6.0, "newton_mm": 1e-4, "interpolation_mm": 1e-3, "estimate_error": False},
    judged=2,
    meshes=[2.0],
    longest_s=60.0,
    train_s=1000.0,
)
EPOCHS = 10  # trainings end by epochs here, so that a slow machine learns as much as a quick one


def bench(folder: Path) -> Bench:
    """The scene, with its store in `folder`."""
    typed = ["split.points=400", "trainer.accelerator=cpu", f"trainer.max_epochs={EPOCHS}"]
    scene = replace(experiment(typed), finger=pneunet(), fem=solid(element="auto"), observation=Observation(10, 400))
    return Bench(scene, SETTINGS, folder)


def points(folder: Path) -> list[Point]:
    """The chart of the scene; its times count for nothing here and are taken from a few predictions."""
    latency.SECONDS, latency.LEAST_REPEATS = 0.0, 2
    return [point for point, _ in all_points(bench(folder))]


def errors(folder: Path) -> dict[str, dict[str, float]]:
    """Total error and the surrogate's own part of each method [mm RMS]."""
    measured = {}
    for point in points(folder):
        parts = {"total": point.total, "surrogate": point.surrogate}
        measured[point.label] = {name: part.rms_mm for name, part in parts.items() if part}
    return measured


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        STORED.write_text(json.dumps(errors(Path(folder)), indent=1) + "\n")
