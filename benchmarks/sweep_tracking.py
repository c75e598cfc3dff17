"""Does `mlflow ui` stay quick with hundreds of trials? Response times of what its pages ask for.

    python benchmarks/sweep_tracking.py [--trials 500]

Fills a database of its own with a study, through the lab's tracking, each trial with as many settings, metrics and
entries of a loss history as a training leaves; then starts MLflow's server on it and asks, as its pages do, for the
newest hundred runs, for the best hundred, for all children of the study, for one run and for one loss history.
"""

import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.common import parsed, parser, show, table

METRICS, EPOCHS, SETTINGS = 60, 40, 60  # of one trial of sweep=architecture
REPEATS = 7


def fill(trials: int) -> tuple[str, str, list[str], float]:
    """Experiment, parent run and children of a study of empty trials, and seconds per trial."""
    from mlflow.entities import Metric, Param

    from pgdl_lab.core import paths
    from pgdl_lab.running import folders, mlflow_server, tracking

    folder = paths.RUNS / "study"
    folder.mkdir(parents=True)
    tracking.open_parent(folder, {"study": "study"})
    client, experiment = mlflow_server.connect()
    children = []
    start = time.perf_counter()
    for number in range(trials):
        job = folder / str(number)
        typed = [f"setting.{n}={number + n}" for n in range(SETTINGS)]
        tags = {"trial": str(number), "trial_state": "complete"}
        tracking.note_job(job, folder, "FINISHED", tags, {"mse": float(number)}, typed)
        children.append((job / folders.RUN_ID).read_text())
        metrics = [Metric(f"metric/{n}", float(n), 0, 0) for n in range(METRICS)]
        metrics += [Metric("raw/data", 1.0 / (step + 1), step, step) for step in range(EPOCHS)]
        client.log_batch(children[-1], metrics=metrics, params=[Param("finger", "pneunet")])
    seconds = (time.perf_counter() - start) / trials
    return experiment, (folder / folders.RUN_ID).read_text(), children, seconds


def ask(url: str, body: Mapping[str, Any] | None = None) -> tuple[float, dict[str, Any]]:
    """Milliseconds until the answer is there, and the answer."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"})
    start = time.perf_counter()
    with urllib.request.urlopen(request, timeout=60) as answer:
        found = json.load(answer)
    return 1e3 * (time.perf_counter() - start), found


def main() -> None:
    """Fill, ask and print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=500)
    chosen = parsed(arguments, trials=5)
    with tempfile.TemporaryDirectory() as place:
        os.environ["PGDL_LAB_ROOT"] = place  # before the lab is imported
        experiment, parent, children, seconds = fill(chosen.trials)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        store = f"sqlite:///{Path(place).resolve()}/mlflow.db"
        command = [sys.executable, "-m", "mlflow", "server", "--backend-store-uri", store, "--port", str(port)]
        server = subprocess.Popen([*command, "--workers", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            api = f"http://127.0.0.1:{port}/api/2.0/mlflow"
            search: dict[str, Any] = {"experiment_ids": [experiment], "max_results": 100}
            mine = {**search, "filter": f"tags.mlflow.parentRunId = '{parent}'"}
            questions = {
                "newest 100 runs": (f"{api}/runs/search", {**search, "order_by": ["attributes.start_time DESC"]}),
                "best 100 of the study": (f"{api}/runs/search", {**mine, "order_by": ["metrics.`objective/mse` ASC"]}),
                "all children of the study": (f"{api}/runs/search", {**mine, "max_results": 1000}),
                "one run": (f"{api}/runs/get?run_id={children[0]}", None),
                "one loss history": (f"{api}/metrics/get-history?run_id={children[0]}&metric_key=raw/data", None),
            }
            limit = time.monotonic() + 120
            while True:
                try:
                    ask(*questions["one run"])
                    break
                except (urllib.error.URLError, ConnectionError):
                    if time.monotonic() > limit:
                        raise
                    time.sleep(0.5)
            title = f"MLflow's server on {chosen.trials} trials, {REPEATS} times each"
            shown = table(title, ("asked for", "entries", "median (ms)", "worst (ms)"))
            for name, question in questions.items():
                asked = [ask(*question) for _ in range(REPEATS)]
                times, answer = [took for took, _ in asked], asked[0][1]
                entries = len(answer.get("runs") or answer.get("metrics") or [1])
                shown.add_row(name, str(entries), f"{statistics.median(times):.0f}", f"{max(times):.0f}")
            show(shown)
            print(f"noting a trial took {1e3 * seconds:.0f} ms")
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
