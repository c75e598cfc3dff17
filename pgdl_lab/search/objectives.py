"""Objectives of a search, read from metrics.json of its trials."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.registry import closest
from pgdl_lab.running.metrics import numbers
from pgdl_lab.search.settings import MISFIT, NONE_LEFT, SELECTION_MM2


def values(folder: Path, objectives: Iterable[str], targets: Mapping[str, Sequence[float]]) -> list[float]:
    """Value of each objective for the run in `folder`.

    Raises
    ------
    InputError
        If a metric has no such name, or there are no points to select by.
    LabError
        If there are no metrics, or one is no finite number.
    """
    file = folder / "metrics.json"
    if not file.is_file():
        raise LabError(f"The task wrote no {file.name}: search with one that does, such as task=train.")
    tree = json.loads(file.read_text(encoding="utf-8"))
    metrics = dict(numbers(tree))
    if any(SELECTION_MM2 in name for name in objectives) and tree.get(SELECTION_MM2, 0) is None:
        raise InputError(NONE_LEFT)

    def metric(name: str) -> float:
        return metrics[closest(name.strip(), metrics, "metric")]

    found = []
    for name in objectives:
        if name == MISFIT:
            value = max(abs(metric(each) - target) / tolerance for each, (target, tolerance) in targets.items())
        else:
            value = sum(metric(term) for term in name.split("+"))
        if not math.isfinite(value):
            raise LabError(f"{name} is {value}.")
        found.append(value)
    return found
