"""The models below the solid: `fem=rod` and `fem=section`."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core import registry
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.fem import Fem, SimulationStopped
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finger_rod import FingerRod
from pgdl_lab.mechanics.reduced import ReducedModel
from pgdl_lab.mechanics.section import STATES, PlaneFinger
from tests.fingers import OBSERVATION, pneunet, solid


def rung(name: str, **fields: Any) -> Fem:
    fem: Fem = registry.plugin("fem", name)(**fields)
    return fem


def plane(finger: Any, share: float) -> PlaneFinger:
    return PlaneFinger(finger, 3.0, replace(STATES["plane_strain"], side_wall_share=share))


def solid_at(finger: Finger) -> Dataset:
    fem: Fem = registry.plugin("fem", "solid")(interpolation_mm=1.0, estimate_error=False)
    return fem.simulate(finger, Observation(1, 1500))


@pytest.mark.parametrize(
    ("name", "fields"), [("rod", {}), ("section", {"state": "plane_strain"}), ("section", {"state": "plane_stress"})]
)
@pytest.mark.parametrize("finger", ["pneunet", "joints", "bellows"])
def test_fingers_bend_down_as_pressure_rises(name: str, fields: dict[str, Any], finger: str) -> None:
    snapshots = rung(name, interpolation_mm=1e-2, **fields).simulate(registry.plugin("finger", finger)(), OBSERVATION)
    assert snapshots.displacements.shape == (10, 800, 2)
    np.testing.assert_allclose(snapshots.displacements[:, snapshots.domain.clamp], 0, atol=1e-9)
    tip = np.diff(snapshots.displacements[:, snapshots.domain.base[-1]], axis=0)
    assert (tip[:, 0] < 0).all()
    told = snapshots.provenance
    assert told["finger"]["name"] == finger and told["fem"]["name"] == name
    assert told["unstable_kpa"] == [] and told["interpolation_error_mm"] <= 1e-2
    assert told["mesh"]["degrees_of_freedom"] > 100


def test_rod_is_the_solid_while_displacements_are_small() -> None:
    """Within 5 % at the end of the base line, under pressure and under weight: the end segments are no periods."""
    for load in ({"gravity_m_s2": [0.0, 0.0], "max_kpa": 0.1}, {"gravity_m_s2": [0.0, -0.01], "max_kpa": 1e-6}):
        body = pneunet(chambers=5, **load)
        reference, ours = solid_at(body), rung("rod").simulate(body, Observation(1, 1500))
        np.testing.assert_array_equal(ours.domain.points_mm, reference.domain.points_mm)
        tip = reference.domain.base[-1]
        np.testing.assert_allclose(ours.displacements[0, tip, 1], reference.displacements[0, tip, 1], rtol=0.05)


@pytest.mark.parametrize(("chambers", "told"), [(1, "is one segment"), (5, "has 5 segments"), (6, "")])
def test_rod_warns_of_fingers_that_are_short(chambers: int, told: str, caplog: pytest.LogCaptureFixture) -> None:
    rung("rod", edge_mm=6.0, interpolation_mm=1.0).simulate(
        pneunet(chambers=chambers, max_kpa=1.0), Observation(1, 200)
    )
    short = [message for message in caplog.messages if "short for fem=rod" in message]
    assert len(short) == bool(told) and all(told in message for message in short)


@pytest.mark.parametrize("name", ["rod", "section"])
def test_chambers_that_would_meet_are_named(name: str, caplog: pytest.LogCaptureFixture) -> None:
    """Contact is left out: thin walls a little apart meet, thick ones far apart do not."""
    thin = {"wall_mm": 1.5, "side_wall_mm": 1.5, "gap_mm": 0.3, "max_kpa": 15.0}
    for fields, meets in ((thin, True), ({}, False)):
        caplog.clear()
        rung(name, edge_mm=6.0, interpolation_mm=1.0).simulate(pneunet(**fields), Observation(2, 200))
        assert (f"Surfaces pass through each other at 7.5 kPa and more, as fem={name} leaves" in caplog.text) == meets


def test_walls_of_segments_bulge_as_those_of_the_solid() -> None:
    """Under a little pressure, the gap between two chambers closes by the same."""
    body = pneunet(wall_mm=1.5, max_kpa=0.5, gravity_m_s2=[0.0, 0.0])
    result = solid(element="hex27_p1", edge_mm=3.0, interpolation_mm=1.0).simulate(body, Observation(1, 200)).body
    assert result is not None
    x, y, z = result.domain.points_mm.T
    facing = [np.flatnonzero(np.isclose(x, place) & (z > 8.01)) for place in (10.5, 11.5)]
    moved = [result.displacements[-1, nodes[np.lexsort((z[nodes], y[nodes]))], 0] for nodes in facing]
    rod = FingerRod(body, 3.0, 1.0)
    state = rod.load(np.array([0.5]), 1e-6, 1e-3).at(0.5)
    one, other = rod.amplitudes(state, 0.5)
    closing = rod.segments[0].right.bulge_mm(one) + rod.segments[1].left.bulge_mm(other)
    assert closing == pytest.approx((moved[0] - moved[1]).max(), rel=0.05)


def test_rod_of_two_segments_is_off_under_a_little_weight() -> None:
    """By some 13 %, where five are within 5 %: it has to warn."""
    body, seen = pneunet(gravity_m_s2=[0.0, -0.01], max_kpa=1e-6), Observation(1, 200)
    fems = solid(element="hex27_p1", interpolation_mm=1.0), rung("rod", edge_mm=6.0, interpolation_mm=1.0)
    exact, found = (
        result.displacements[0, result.domain.base[-1]] for result in (fem.simulate(body, seen) for fem in fems)
    )
    assert 0.1 < np.linalg.norm(found - exact) / np.linalg.norm(exact) < 0.16


def test_rod_side_face_has_no_steps_between_segments() -> None:
    """Neighbours on the base line move alike, also across the cuts."""
    snapshots = rung("rod").simulate(pneunet(chambers=4), OBSERVATION)
    moved = snapshots.domain.points_mm[snapshots.domain.base] + snapshots.displacements[-1, snapshots.domain.base]
    distance = np.linalg.norm(np.diff(moved, axis=0), axis=1) / np.diff(
        snapshots.domain.points_mm[snapshots.domain.base, 0]
    )
    assert np.ptp(distance) < 0.25


def test_section_keeps_its_weight_whatever_its_side_walls_bear() -> None:
    finger: Any = pneunet()
    models = [plane(finger, share).equilibrium for share in (1.0, 0.01)]
    whole, soft = (each.drive(np.zeros(each.free.shape), {"weight": 1.0}) for each in models)
    np.testing.assert_allclose(whole, soft)
    volume = models[0].solid.discretisation.weights.sum()
    np.testing.assert_allclose(whole.sum(axis=0), [0, 0, -1130e-12 * 9810 * volume])


def test_air_pushes_only_against_its_boundary() -> None:
    """Displacements inside the air change nothing, rigid motions neither; the volume is that of the cavity."""
    finger: Any = pneunet(chambers=1)
    equilibrium = plane(finger, 1.0).equilibrium
    positions = equilibrium.solid.discretisation.positions
    (volume,) = equilibrium.volumes_mm3(np.zeros_like(positions)).values()
    np.testing.assert_allclose(volume, 4.5 * 11 * 10)  # one chamber, channel and all: 4.5 by 11 by 10 mm
    turned = positions @ np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]) - positions
    np.testing.assert_allclose(equilibrium.volumes_mm3(turned)["air"], volume)
    forces = equilibrium.drive(np.zeros_like(positions), {"air": 1.0})
    x, _, z = positions.T
    inside = (x > 3) & (x < 7.5) & (z > 3) & (z < 14)
    assert inside.any() and np.abs(forces[inside]).max() < 1e-9
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-9)


@pytest.mark.parametrize("name", ["rod", "section"])
def test_fingers_without_a_profile_are_refused(name: str) -> None:
    mesh = registry.plugin("finger", "mesh")(path="examples/finger.msh")
    with pytest.raises(InputError, match=f"fem={name} is made from the x–z profile .* choose fem=solid"):
        rung(name).simulate(mesh, OBSERVATION)


@pytest.mark.parametrize(
    ("name", "fields", "sentence"),
    [
        ("rod", {"edge_mm": 0.0}, "fem.edge_mm is 0.0 mm"),
        ("rod", {"step_mm": -1.0}, "fem.step_mm is -1.0 mm"),
        ("section", {"newton_mm": 0.0}, "fem.newton_mm is 0.0 mm"),
        ("section", {"side_wall_share": 0.0}, "fem.side_wall_share is 0.0; it must be above 0 and at most 1"),
        ("section", {"state": "plane"}, "fem.state is 'plane'; choose one of plane_strain, plane_stress"),
        ("section", {"side_wall_share": 1.5}, "fem.side_wall_share is 1.5"),
    ],
)
def test_impossible_models_are_refused(name: str, fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        rung(name, **fields)


def test_what_converged_before_a_failure_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    load = ReducedModel.load
    monkeypatch.setattr(
        ReducedModel, "load", lambda self, kpa, *rest: replace(load(self, kpa / 2, *rest), complete=False)
    )
    with pytest.raises(
        SimulationStopped, match=r"up to 10 kPa, .*finger.max_kpa=20: 5 of 10 .*choose fem=solid"
    ) as stop:
        rung("section", state="plane_strain").simulate(pneunet(), OBSERVATION)
    kept = stop.value.snapshots
    np.testing.assert_allclose(kept.pressures_kpa, [2, 4, 6, 8, 10])
    assert kept.displacements.shape == (5, 800, 2)


@pytest.mark.parametrize("name", ["rod", "section"])
def test_plane_models_refuse_a_pull_along_y(name: str) -> None:
    with pytest.raises(InputError, match=f"fem={name} moves in the x–z plane alone"):
        rung(name).simulate(pneunet(gravity_m_s2=[0.0, 9.81, 0.0]), OBSERVATION)


def test_section_moves_in_the_plane_but_for_its_root() -> None:
    equilibrium = plane(pneunet(), 1.0).equilibrium
    positions = equilibrium.solid.discretisation.positions
    assert not positions[:, 1].any() and positions[:, 0].min() == 0
    np.testing.assert_array_equal(equilibrium.free, np.outer(positions[:, 0] > 1e-9, [True, False, True]))


def test_section_is_stiffer_the_more_of_its_side_walls_counts() -> None:
    tips = []
    for share in (0.2, 0.4, None, 1.0):
        found = rung("section", edge_mm=6.0, side_wall_share=share, interpolation_mm=1.0).simulate(
            pneunet(max_kpa=5.0, gravity_m_s2=[0.0, 0.0]), Observation(1, 200)
        )
        tips.append(-found.displacements[0, found.domain.base[-1], 1])
        seconds = found.provenance["seconds_of"]
        assert sum(seconds.values()) == pytest.approx(found.provenance["seconds"]) and min(seconds.values()) > 0
    assert tips[0] > tips[1] > tips[3] > 0 and tips[2] == pytest.approx(tips[1], rel=1e-9)  # 0.4 unless told otherwise
