"""The jobs of a multirun side by side."""

import csv
import json
from pathlib import Path

import pytest

from pgdl_lab.running.multirun import compare
from pgdl_lab.running.sweep import FAILURE, OVERRIDES

METRICS = {
    "seconds": {"simulate": 123.4, "train": 56.7},
    "latency_ms": {"full_field": {"median": 0.0123}},
    "extremes_mm": {"fem": {"x": [-62.52, 11.19], "z": [-105.24, 0.0]}},
    "discretisation_error": {"kpa": 40.0, "tip_mm": 0.0434},
}


def sweep(folder: Path, settings: list[list[str]], failed: int | None = None) -> Path:
    for number, typed in enumerate(settings):
        job = folder / str(number)
        job.mkdir(parents=True)
        (job / OVERRIDES).write_text(json.dumps(typed))
        if number == failed:
            (job / FAILURE).write_text("It burst.")
            continue
        changing = {
            "mse_mm2": {"x": 1.23e-5 * (1 + number), "z": 4.56e-5 * (1 + number)},
            "seconds": {"simulate": 100.0 + number, "train": 50.0 + number},
            "latency_ms": {"full_field": {"median": 0.01 * (1 + number)}},
            "extremes_mm": {"fem": {"x": [-62.52 - number, 11.19], "z": [-105.24 - number, 0.0]}},
        }
        (job / "metrics.json").write_text(json.dumps({**METRICS, **changing}))
    return folder


@pytest.mark.parametrize("columns", [60, 80, 200])
@pytest.mark.parametrize(
    "settings",
    [
        [["finger.max_kpa=5", "model=pod"], ["finger.max_kpa=6", "model=pod"], ["finger.max_kpa=7", "model=pod"]],
        [["observation.points=1234567", "model.hidden_activation=tanh_shrink"], ["seed=2"], ["model=body", "seed=3"]],
    ],
)
def test_jobs_and_settings_are_read_whatever_the_width(
    settings: list[list[str]],
    columns: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setattr("pgdl_lab.running.multirun._figure", lambda rows, keys, path: path)
    written = compare(sweep(tmp_path, settings, failed=1))
    shown = capsys.readouterr().out
    lines = shown.splitlines()
    assert max(map(len, lines)) <= columns
    table = [[cell.strip() for cell in line.split("│")[1:-1]] for line in lines if line.startswith("│")]
    assert [row[0] for row in table if row[0]] == ["0", "1", "2"]
    told = " ".join(row[1] for row in table)
    same = {setting for setting in settings[0] if all(setting in typed for typed in settings)}
    if columns >= 80:
        assert all(setting in told for typed in settings for setting in typed if setting not in same)
    assert "MSE x" in shown and "1.23e-05" in shown and "failed" in shown
    assert (columns < 200) == ("More is in" in shown)
    if columns == 200:
        assert "mesh error" in shown and "0.0434" in shown
    with written[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["extremes_mm.fem.z.0"] == "-105.24" and rows[1]["error"] == "It burst."


def test_jobs_that_do_not_differ_are_shown_with_all_that_is_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep(tmp_path, [["seed=1"], ["seed=2"]])
    (tmp_path / "1" / "metrics.json").write_bytes((tmp_path / "0" / "metrics.json").read_bytes())
    names = [path.name for path in compare(tmp_path)]
    assert names == ["comparison.csv", "comparison.png"] and (tmp_path / names[1]).stat().st_size > 1000
    assert "MSE x" in capsys.readouterr().out
