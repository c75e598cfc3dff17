"""Further loads: a force at the tip, chambers with pressures of their own, gravity that turns."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from pgdl_lab.core import paths, registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.elements import Discretisation
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.mechanics.linear import symmetric_solver
from pgdl_lab.mechanics.loading import LoadLeg
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.newton import solve
from pgdl_lab.mechanics.path import follow
from pgdl_lab.mechanics.profile import Profile, Region
from pgdl_lab.mechanics.term import DeadLoad, Ramp, Schedule, Term
from tests.conftest import CHECKOUT
from tests.fingers import pneunet, solid

registry.discover()
LENGTH_MM, WIDTH_MM, HEIGHT_MM, BORE_MM = 60.0, 10.0, 6.0, (4.0, 2.0)


@dataclass(frozen=True)
class Pulled(ExtrudedFinger):
    """A bar with a closed bore in its middle, and a force along z at its end."""

    kind: ClassVar[str] = "finger"
    name: ClassVar[str] = "pulled"
    width_mm: float = WIDTH_MM
    density_kg_m3: float = 0.0
    tip_n: float = -2e-4

    def profile(self) -> Profile:
        solid, bored = [Region.SOLID] * 3, [Region.SOLID, Region.CAVITY, Region.SOLID]
        heights = np.cumsum([0.0, (HEIGHT_MM - BORE_MM[1]) / 2, BORE_MM[1], (HEIGHT_MM - BORE_MM[1]) / 2])
        return Profile.from_columns(heights.tolist(), [(1.0, solid), (LENGTH_MM - 2.0, bored), (1.0, solid)])

    def loads(self, body: Discretisation) -> dict[str, Term]:
        mesh = body.basis.mesh
        end = mesh.facets_satisfying(lambda x: np.isclose(x[0], LENGTH_MM), boundaries_only=True)
        traction_mpa = np.array([0.0, 0.0, self.tip_n / (WIDTH_MM * HEIGHT_MM)])
        return {**super().loads(body), "tip": DeadLoad.traction(body, end, traction_mpa)}

    def schedules(self) -> tuple[Schedule, Schedule]:
        held = {"weight": 1.0, "tip": 1.0}
        return Ramp(held), Ramp({"air": 1e-3}, held=held)


@pytest.fixture
def pulled() -> Pulled:
    return Pulled(side_wall_mm=(WIDTH_MM - BORE_MM[0]) / 2, material=Yeoh(poisson=0.0), max_kpa=1.0)


def test_a_force_at_the_tip_bends_a_beam_by_timoshenko(pulled: Pulled) -> None:
    """Held along the whole path, from where the pressure begins; the support bears it."""
    model = Model(pulled, 6.0, "hex27_p1")
    history = model.load(np.array([1.0]), 1e-9, 1e-3)
    inertia = (WIDTH_MM * HEIGHT_MM**3 - BORE_MM[0] * BORE_MM[1] ** 3) / 12
    area, shear_mpa = WIDTH_MM * HEIGHT_MM - BORE_MM[0] * BORE_MM[1], pulled.material.shear_modulus_mpa
    sag = pulled.tip_n * (LENGTH_MM**3 / (3 * 2 * shear_mpa * inertia) + LENGTH_MM / (5 / 6 * shear_mpa * area))
    end = np.isclose(model.discretisation.positions[:, 0], LENGTH_MM)
    assert history.at(0.0)[end, 2].mean() == pytest.approx(sag, rel=5e-3)
    reaction, load = model.reaction_and_load_n(history.at(1.0), 1.0)
    np.testing.assert_allclose([load[2], -reaction[2]], pulled.tip_n / 2, rtol=1e-9)  # of half the bar


def test_the_whole_simulation_takes_the_force_along(pulled: Pulled) -> None:
    """Meshed as half and as whole, refined, and told in the provenance; models that know nothing of it refuse it."""
    seen, found = Observation(2, 100), {}
    for gravity in ([0.0, -9.81], [0.0, 1e-9, -9.81]):
        fem = solid(edge_mm=12.0, contact="off", estimate_error=len(gravity) == 2)
        found[len(gravity)] = fem.simulate(replace(pulled, gravity_m_s2=gravity), seen)
    np.testing.assert_allclose(found[2].displacements, found[3].displacements, atol=1e-9)
    assert found[3].provenance["load_n"][2] == pytest.approx(pulled.tip_n, rel=1e-6)
    assert 0 < found[2].provenance["discretisation_error"]["tip_percent"] < 20
    for name in ("rod", "section", "calculix"):
        with pytest.raises(InputError, match=f"fem={name} knows weight and one pressure alone, .*also has tip: choose"):
            registry.plugin("fem", name)().simulate(pulled, seen)


@dataclass(frozen=True)
class TwoChambers(ExtrudedFinger):
    """Two chambers that nothing joins, the second at half the pressure of the first."""

    width_mm: float = 12.0

    def profile(self) -> Profile:
        solid, hollow = [Region.SOLID] * 3, [Region.SOLID, Region.CAVITY, Region.SOLID]
        columns = [(3.0, solid), (6.0, hollow), (3.0, solid), (6.0, hollow), (3.0, solid)]
        return Profile.from_columns([0.0, 4.0, 10.0, 12.0], columns)

    def loads(self, body: Discretisation) -> dict[str, Term]:
        mesh = body.basis.mesh
        walls = np.asarray(mesh.boundaries["cavity"])
        first = mesh.p[0, mesh.facets[:, walls]].mean(axis=0) < 10.5
        weight = super().loads(body)["weight"]
        chambers = {"root": Cavity(body.basis, walls[first]), "end": Cavity(body.basis, walls[~first])}
        return {**chambers, "weight": weight}

    def schedules(self) -> tuple[Schedule, Schedule]:
        weight = {"weight": 1.0}
        return Ramp(weight), Ramp({"root": 1e-3, "end": 0.5e-3}, held=weight)


@pytest.fixture(scope="module")
def two() -> Model:
    return Model(TwoChambers(max_kpa=20.0), 6.0, "hex27_p1")


def full(stiffness: Any) -> Any:
    upper = stiffness.toarray()
    return upper + np.triu(upper, 1).T


def test_the_tangent_of_chambers_with_pressures_of_their_own(two: Model) -> None:
    equilibrium, random, step = two.equilibrium, np.random.default_rng(0), 1e-6
    load = {"root": 0.03, "end": -0.02, "weight": 0.5}
    at = 0.05 * random.normal(size=equilibrium.free.shape) * equilibrium.free
    direction = random.normal(size=at.shape) * equilibrium.free
    here = equilibrium.balance(at, load, stiffness=True)
    after, before = (equilibrium.balance(at + s * step * direction, load, stiffness=False) for s in (1, -1))
    change = (after.forces - before.forces)[equilibrium.free] / (2 * step)
    np.testing.assert_allclose(
        full(here.stiffness) @ direction[equilibrium.free], change, atol=1e-7 * abs(change).max()
    )
    slope = (after.energy - before.energy) / (2 * step)
    assert slope == pytest.approx(float((here.forces * direction).sum()), rel=1e-7)


def test_chambers_at_one_pressure_are_one_cavity(two: Model) -> None:
    parts, random = two.equilibrium, np.random.default_rng(1)
    alone = {name: parts.terms[name] for name in ("solid", "weight")}
    whole = Equilibrium({**alone, "air": Cavity(two.discretisation.basis)}, parts.free)
    at = 0.05 * random.normal(size=parts.free.shape)
    ours = parts.balance(at, {"root": 0.02, "end": 0.02, "weight": 1.0}, stiffness=True)
    theirs = whole.balance(at, {"air": 0.02, "weight": 1.0}, stiffness=True)
    assert ours.energy == pytest.approx(theirs.energy, rel=1e-12)
    np.testing.assert_allclose(ours.forces, theirs.forces, atol=1e-14)
    assert ours.stiffness is not None and theirs.stiffness is not None
    np.testing.assert_allclose(full(ours.stiffness), full(theirs.stiffness), atol=1e-14)
    volumes = parts.volumes_mm3(np.zeros_like(at))
    assert volumes == {"root": pytest.approx(6 * 6 * 3), "end": pytest.approx(6 * 6 * 3)}  # half of each
    moved = parts.volumes_mm3(at)
    assert sum(moved.values()) == pytest.approx(whole.volumes_mm3(at)["air"], rel=1e-12) and moved != volumes


def test_the_path_raises_each_pressure_by_its_own_rate(two: Model) -> None:
    history = two.load(np.array([10.0, 20.0]), 1e-9, 1e-6)
    for kpa in (10.0, 20.0):
        load = {"root": 1e-3 * kpa, "end": 0.5e-3 * kpa, "weight": 1.0}
        exact = solve(two.equilibrium, two.solver, history.at(kpa), load, 1e-10).displacement
        np.testing.assert_allclose(history.at(kpa), exact, atol=1e-6)
    swollen, rest = (two.volumes_mm3(at) for at in (history.at(20.0), history.at(0.0)))
    assert swollen["root"] - rest["root"] > 1.5 * (swollen["end"] - rest["end"]) > 0
    two.solver.close()


@dataclass(frozen=True)
class Turning:
    """Gravity that turns from −z to x, by the angle [rad]."""

    size: float

    def at(self, parameter: float) -> Mapping[str, float]:
        return {"x": self.size * np.sin(parameter), "z": -self.size * np.cos(parameter)}

    def rates(self, parameter: float) -> Mapping[str, float]:
        return {"x": self.size * np.cos(parameter), "z": self.size * np.sin(parameter)}


def test_gravity_that_turns_ends_where_it_would_have_hung_at_once() -> None:
    """Along a path on which nothing but the schedule is new; in between, the interpolation knows the way."""
    ends = {name: Model(pneunet(gravity_m_s2=g), 6.0, "hex20") for name, g in (("x", [9.81, 0.0]), ("z", [0.0, -9.81]))}
    resting = {name: model.load(np.array([1.0]), 1e-9, 1.0).at(0.0) for name, model in ends.items()}
    body, density = ends["z"].discretisation, 1130e-12
    turned = ends["z"].equilibrium.with_terms(
        x=DeadLoad.weight(body, np.array([density, 0.0, 0.0])), z=DeadLoad.weight(body, np.array([0.0, 0.0, density]))
    )
    solver = symmetric_solver()
    leg = LoadLeg(turned, solver, 1e-9, Turning(9810.0))
    branch = follow(leg, resting["z"], np.pi / 2, 0.2, lambda _: None)
    np.testing.assert_allclose(branch.displacements[0], resting["z"], atol=1e-9)
    np.testing.assert_allclose(branch.displacements[-1], resting["x"], atol=1e-9)
    between = 0.9
    exact = solve(turned, solver, branch.at(between), Turning(9810.0).at(between), 1e-10).displacement
    np.testing.assert_allclose(branch.at(between), exact, atol=1e-5)
    solver.close()


def test_a_load_acts_only_by_its_name(two: Model) -> None:
    equilibrium, rest = two.equilibrium, np.zeros(two.equilibrium.free.shape)
    assert not equilibrium.balance(rest, {}, stiffness=False).forces.any()
    with pytest.raises(InputError, match="No load is named air: there are root, end, weight"):
        equilibrium.balance(rest, {"air": 0.01}, stiffness=False)
    heavier = equilibrium.with_terms(tip=DeadLoad(np.ones_like(rest)))
    assert "tip" not in equilibrium.terms
    np.testing.assert_array_equal(heavier.balance(rest, {"tip": 2.0}, stiffness=False).forces, -2.0)
    assert heavier.balance(rest + 1, {"tip": 2.0}, stiffness=False).energy == pytest.approx(-2.0 * rest.size)


def test_other_terms_are_put_together_at_their_own_nodes(two: Model) -> None:
    equilibrium, rest = two.equilibrium, np.zeros(two.equilibrium.free.shape)
    swapped = equilibrium.with_terms(root=equilibrium.terms["end"], end=equilibrium.terms["root"])
    for ours, theirs in (("root", "end"), ("end", "root")):
        one, other = (
            swapped.balance(rest, {ours: 0.1}, stiffness=True),
            equilibrium.balance(rest, {theirs: 0.1}, stiffness=True),
        )
        assert one.stiffness is not None and other.stiffness is not None
        np.testing.assert_allclose(one.forces, other.forces, atol=1e-14)
        np.testing.assert_allclose(full(one.stiffness), full(other.stiffness), atol=1e-14)


def test_the_example_in_the_docs_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As it stands; the force is told beside the weight, by half, and pulls the finger down."""
    (source,) = re.findall(r"```python\n(.*?)```", (CHECKOUT / "docs" / "mechanics.md").read_text("utf-8"), re.DOTALL)
    for known in (registry._plugins["finger"], registry._nodes):
        for name in ("pulled", ("finger", "pulled"), ("finger/material", "pulled")):
            monkeypatch.setitem(known, name, None)  # put back afterwards as it was
            monkeypatch.delitem(known, name)
    monkeypatch.setattr(paths, "RUNS", tmp_path)
    names: dict[str, Any] = {"__name__": "example"}
    exec(source, names)
    with_force, fem, seen = names["data"], solid(), Observation(1, 100)
    without = fem.simulate(names["Pulled"](chambers=2, max_kpa=10.0, tip_n=0.0), seen)
    weight = without.provenance["load_n"][2]
    assert with_force.provenance["load_n"][2] == pytest.approx(weight - 0.01, rel=1e-9)
    assert with_force.displacements[-1, :, 1].min() < without.displacements[-1, :, 1].min() - 0.05
