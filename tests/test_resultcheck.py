"""What a result tells of itself: whether what moves is what is observed, for every finger and model."""

import logging
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core import registry
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import DISPLACEMENT
from pgdl_lab.core.domain import Domain
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.fem import Fem, SimulationStopped
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.resultcheck import doubts
from pgdl_lab.running.cache import simulate
from tests.fingers import pneunet, solid
from tests.meshes import bricks, groups, inside, save, skin
from tests.synthetic import with_domain

registry.discover()

FEW = Observation(snapshots=2, points=200)


def snapshots(**changes: Any) -> Dataset:
    """A bar of 40 × 12 × 12 mm that bends down by 2 mm, or with other arrays."""
    nodes = np.stack(np.meshgrid(np.linspace(0, 40, 9), [0.0, 6.0], [0.0, 12.0], indexing="ij"), -1).reshape(-1, 3)
    points = nodes[nodes[:, 1] == 6][:, [0, 2]]
    moved = np.zeros((1, len(nodes), 3))
    moved[..., 2] = -2 * (nodes[:, 0] / 40) ** 2
    given: dict[str, Any] = {
        "points_mm": points,
        "cells": np.array([[0, 1, 2]]),
        "base": np.flatnonzero(points[:, 1] == 0),
        "clamp": np.flatnonzero(points[:, 0] == 0),
        "kpa": np.array([10.0]),
        "displacements": moved[:, nodes[:, 1] == 6][:, :, [0, 2]],
        "body": Dataset.path(Domain(nodes, np.arange(8)[None], "hexahedron"), np.array([10.0]), moved),
    } | changes
    face = Domain(**{name: given.pop(name) for name in ("points_mm", "cells", "base", "clamp")})
    return Dataset.path(face, given.pop("kpa"), given.pop("displacements"), **given)


def moved(**along: float) -> Dataset:
    """The body of `snapshots`, whose tip moves `along` x, y or z [mm]."""
    body = snapshots().body
    assert body is not None
    displacements = np.zeros_like(body.displacements)
    for axis, size in along.items():
        displacements[..., "xyz".index(axis)] = size * body.domain.points_mm[:, 0] / 40
    return replace(body, fields={DISPLACEMENT: displacements})


def test_bending_finger_leaves_no_doubt() -> None:
    assert doubts(snapshots(), pneunet()) == []
    assert doubts(snapshots(body=None), pneunet()) == []


@pytest.mark.parametrize("body", [True, False])
def test_base_line_that_ends_early(body: bool) -> None:
    whole = snapshots()
    base = whole.domain.base
    x = whole.domain.points_mm[base, 0]
    short = with_domain(whole, base=base[x <= (35 if body else 30)])
    short = short if body else replace(short, body=None)
    (told,) = doubts(short, pneunet())
    end = 35 if body else 30
    assert told.startswith(
        f"The base line, whose end is the tip of every surrogate, spans x = 0 to {end}, but the body"
    )
    assert doubts(with_domain(whole, base=base[x <= 36.0 + 4]), pneunet()) == []


def test_base_line_that_begins_late() -> None:
    whole = snapshots()
    base, points = whole.domain.base, whole.domain.points_mm
    late = with_domain(whole, base=base[points[base, 0] >= 10])
    (told,) = doubts(late, pneunet())
    assert "spans x = 10 to 40" in told
    held = np.flatnonzero(points[:, 0] <= 10)  # the root is held that far
    assert doubts(with_domain(late, clamp=held), pneunet()) == []
    (told,) = doubts(with_domain(whole, base=np.array([], dtype=np.int64)), pneunet())
    assert "has no points" in told


def test_base_line_with_a_gap() -> None:
    whole = snapshots(
        points_mm=np.column_stack([np.linspace(0, 40, 41), np.zeros(41)]), base=np.arange(41), clamp=np.array([0])
    )
    whole = replace(whole, fields={DISPLACEMENT: np.full((1, 41, 2), -2.0)})
    assert doubts(whole, pneunet()) == []
    x = whole.domain.points_mm[:, 0]
    (told,) = doubts(with_domain(whole, base=np.flatnonzero((x <= 10) | (x >= 20))), pneunet())
    assert "The base line has no points from x = 10 to 20 mm" in told


def test_motion_across_is_told_with_numbers() -> None:
    finger = pneunet()
    (told,) = doubts(snapshots(body=moved(y=10.9, z=0.12)), finger)
    assert told.startswith("Most of the motion at 10 kPa, 10.9 mm, is along y, which no surrogate has; along x and z")
    assert "at most 0 and 0.12 mm: is z up?" in told
    assert doubts(snapshots(body=moved(y=1.9, z=-2.0)), finger) == []
    (told,) = doubts(snapshots(body=moved(y=10.9, z=0.12)), replace(finger, gravity_m_s2=[0.0, 9.81, 0.0]))
    assert told.endswith("at most 0 and 0.12 mm.")


def test_motion_that_the_face_does_not_see() -> None:
    still = snapshots(displacements=np.full_like(snapshots().displacements, 1e-3))
    (told,) = doubts(still, pneunet())
    assert "the observed side face moves by at most 0.00141 mm, but another part of the body by 2 mm" in told


class Still(Fem):
    """A model whose finger stands still at the face that it observes, and may stop."""

    kind, name = "fem", "still"
    stops = False

    def simulate(self, finger: Finger, observation: Observation) -> Dataset:
        found = snapshots(displacements=np.zeros_like(snapshots().displacements), provenance={})
        logging.getLogger("pgdl_lab.plugins.fem.still").warning("Its own.")
        if self.stops:
            raise SimulationStopped("It stopped.", found)
        return found


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> type[Still]:
    from pgdl_lab.running import cache

    monkeypatch.setattr(cache, "describe", lambda part: {"name": getattr(part, "name", "part"), "as": repr(part)})
    return Still


@pytest.mark.parametrize("stops", [False, True])
def test_warnings_go_with_the_snapshots_and_every_run_tells_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, still: type[Still], stops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(still, "stops", stops)
    for times in (1, 2, 3):
        with pytest.raises(SimulationStopped) if stops else nullcontext():
            simulate(pneunet(), still(), FEW, tmp_path)
        (path,) = tmp_path.glob("*.h5")
        own, told = Dataset.load(path).provenance["warnings"]
        assert own == "Its own." and told.startswith("At 10 kPa the observed side face moves by at most 0 mm")
        assert caplog.text.count(own) == caplog.text.count(told) == times


def test_doubts_of_a_mesh_go_with_its_result(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A body that is even on both sides, but for a chamber that makes it bend across."""
    points, cells = bricks(
        lambda i, j, k: 1 <= i <= 6 and j == 1 and k == 1, ys=(-6.0, -1.0, 5.0, 6.0), zs=(0, 4, 8, 12)
    )
    named = groups(points, skin(cells)) | {"cavity": inside(points[skin(cells)].mean(axis=1), (5, -1, 4), (35, 5, 8))}
    finger: Finger = registry.plugin("finger", "mesh")(
        path=str(save(tmp_path / "a.vtu", points, cells, named)), max_kpa=20.0, gravity_m_s2=[0.0, 0.0], symmetry="none"
    )
    found, _, _ = simulate(finger, solid(interpolation_mm=1e-2), FEW, tmp_path)
    sides, across = found.provenance["warnings"]
    assert sides.startswith("The two sides of") and across.startswith("Most of the motion at 20 kPa")
    for told in (sides, across):
        assert caplog.text.count(told) == 1
