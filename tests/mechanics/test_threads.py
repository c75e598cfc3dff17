"""Threads of a simulation: as many as it is told, else one for each core."""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import ipctk
import numpy as np
import pytest

from pgdl_lab.mechanics import solid
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.threads import threads
from tests.fingers import pneunet


@pytest.mark.parametrize(("told", "expected"), [("3", 3), ("4,2", 4), ("", None), ("0", None), ("many", None)])
def test_threads_as_told_else_one_for_each_core(
    told: str, expected: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 5, 6, 7}, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", told)
    assert threads() == (expected or 5)


@pytest.mark.parametrize("told", [1, 3])
def test_a_simulation_works_with_the_threads_it_is_told(told: int, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = []

    def counting(count: int) -> Any:
        counts.append(count)
        return ThreadPoolExecutor(count)

    monkeypatch.setenv("OMP_NUM_THREADS", str(told))
    monkeypatch.setattr(solid, "ThreadPoolExecutor", counting)
    model = Model(pneunet(), 6.0, "hex20", "auto")
    model.equilibrium.solid.response(np.zeros_like(model.discretisation.positions), stiffness=False)
    assert counts == [told]
    assert ipctk.get_num_threads() == min(told, os.cpu_count() or 1)
