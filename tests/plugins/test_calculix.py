import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core import registry
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.calculix import Increment, read_displacements, read_increments
from pgdl_lab.mechanics.calculix_deck import FACES, deck
from pgdl_lab.mechanics.fem import Fem, SimulationStopped
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model
from pgdl_lab.running.cache import snapshot_path
from tests.fingers import OBSERVATION, balloon, pneunet, solid
from tests.needs import need

needs_ccx = pytest.mark.usefixtures("ccx")


@pytest.fixture(scope="module")
def ccx() -> None:
    need("ccx")


def calculix(**fields: object) -> Fem:
    fem: Fem = registry.plugin("fem", "calculix")(**{"edge_mm": 6.0, **fields})
    return fem


def sections(finger: Finger) -> tuple[Model, dict[str, list[list[str]]]]:
    """The model of `finger`, and the cells of the lines under each card of its deck; steps add up."""
    model = Model(finger, 6.0, "hex20")
    cards: dict[str, list[list[str]]] = {}
    for line in deck(model, finger, np.array([10.0, 20.0]), 0.01).splitlines():
        if line.startswith("*"):
            rows = cards.setdefault(line, [])
        else:
            rows.append(line.rstrip(",").split(","))
    return model, cards


class TestDeck:
    def test_has_the_mesh_of_the_solid(self) -> None:
        model, cards = sections(pneunet())
        nodes = np.array(cards["*NODE,NSET=BODY"], dtype=float)
        np.testing.assert_allclose(nodes[:, 1:], model.discretisation.positions, atol=1e-9)
        rows = cards["*ELEMENT,TYPE=C3D20R,ELSET=BODY"]
        elements = np.array([first + second for first, second in zip(rows[::2], rows[1::2], strict=True)], dtype=int)
        assert elements.shape == (57, 21)
        np.testing.assert_array_equal(elements[:, 1:] - 1, model.domain().cells)

    def test_presses_on_the_cavity_walls(self) -> None:
        model, cards = sections(pneunet())
        cells, positions = model.domain().cells, model.discretisation.positions
        pressed = [(int(element) - 1, int(face[1]) - 1) for element, face, _ in cards["*DLOAD"][1:]]
        middles = [positions[cells[element][FACES[face]]].mean(axis=0) for element, face in pressed]
        walls = model.mesh.p[:, model.mesh.facets[:, model.mesh.boundaries["cavity"]]].mean(axis=1).T
        np.testing.assert_allclose(np.sort(middles, axis=0), np.sort(walls, axis=0), atol=1e-9)
        assert {float(row[2]) for row in cards["*DLOAD"][1:]} == {20e3}  # Pa

    def test_states_the_material_and_the_weight(self) -> None:
        finger = pneunet(gravity_m_s2=[3.0, 0.0, -4.0])
        _, cards = sections(finger)
        law = finger.material
        wanted = [1e6 * law.c1_mpa, 1e6 * law.c2_mpa, 0, 2e-6 / law.bulk_modulus_mpa]
        coefficients = np.array(cards["*HYPERELASTIC,YEOH"][0], dtype=float)
        np.testing.assert_allclose(coefficients[:4], wanted, rtol=1e-9)
        assert (coefficients[4:] > 1e10).all()
        assert cards["*DLOAD"][0] == ["BODY", "GRAV", "5000", "0.6", "0", "-0.8"]
        # density [kg/m³] · gravity [m/s²] = 1e-6 · density · 1e3 · gravity [Pa/mm]
        assert cards["*DENSITY"] == [["0.00113"]]

    @pytest.mark.parametrize(
        ("law", "fields", "form", "constants", "volumetric_terms"),
        [
            ("mooney_rivlin", {"c10_mpa": 0.09, "c01_mpa": 0.02}, "MOONEY-RIVLIN", [9e4, 2e4], 1),
            # μ_i of CalculiX is μ_i α_i / 2 here
            ("ogden", {"mu_mpa": [0.22], "alpha": [2.0]}, "OGDEN,N=1", [2.2e5, 2], 1),
            (
                "ogden", {"mu_mpa": [0.2, 0.04, -0.01], "alpha": [1.0, 5.0, -2.0]},
                "OGDEN,N=3", [1e5, 1, 1e5, 5, 1e4, -2], 3,
            ),
        ],
    )  # fmt: skip
    def test_states_other_laws(
        self, law: str, fields: dict[str, Any], form: str, constants: list[float], volumetric_terms: int
    ) -> None:
        finger = pneunet(material=registry.plugin("material", law)(**fields))
        rows = sections(finger)[1][f"*HYPERELASTIC,{form}"]
        assert all(len(row) <= 8 for row in rows)
        stated = np.array([value for row in rows for value in row], dtype=float)
        np.testing.assert_allclose(
            stated[: len(constants) + 1], [*constants, 2e-6 / finger.material.bulk_modulus_mpa], rtol=1e-9
        )
        assert len(stated) == len(constants) + volumetric_terms
        assert (stated[len(constants) + 1 :] > 1e10).all()

    def test_refuses_more_terms_than_calculix_takes(self) -> None:
        finger = pneunet(material=registry.plugin("material", "ogden")(mu_mpa=4 * [0.1], alpha=[1.0, 2.0, 3.0, 4.0]))
        with pytest.raises(InputError, match=r"CalculiX takes 3 terms of Ogden's at most, not 4: choose fem=solid"):
            sections(finger)

    def test_without_weight_there_is_one_step(self) -> None:
        _, cards = sections(pneunet(gravity_m_s2=[0.0, 0.0]))
        assert len(cards["*STATIC"]) == 1 and cards["*DLOAD"][0][1] != "GRAV"
        assert cards["*TIME POINTS,NAME=OBSERVED"] == [["10"], ["20"]]


class TestResultFiles:
    def test_progress_tells_increments_that_failed(self, tmp_path: Path) -> None:
        file = tmp_path / "finger.sta"
        assert read_increments(file) == []
        file.write_text(
            "SUMMARY OF JOB INFORMATION\n  STEP      INC     ATT  ITRS     TOT TIME     STEP TIME      INC TIME\n"
            "     1          6     1     2  0.100000E+01  0.100000E+01  0.875000E-01\n"
            "     2         10     1U   16  0.121000E+03  0.120000E+03  0.750000E+01\n"
            "     2         10     2     7  0.1228"
        )
        assert read_increments(file) == [Increment(1, True, 2, 1.0), Increment(2, False, 16, 120.0)]

    def test_a_table_cut_short_is_left_out(self, tmp_path: Path) -> None:
        file = tmp_path / "finger.dat"
        head = "\n displacements (vx,vy,vz) for set BODY and time  0.1000000E+01\n\n"
        whole = "         1  0.000000E+00  1.000000E-03 -2.000000E+01\n"
        whole += "         2  1.000000E+00  0.000000E+00  3.000000E+00\n"
        file.write_text(head + whole + head + whole[:-5])
        (table,) = read_displacements(file, 2)
        np.testing.assert_array_equal(table, [[0, 1e-3, -20], [1, 0, 3]])


def test_another_version_of_the_program_is_another_simulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    program, found = tmp_path / "ccx", {snapshot_path(tmp_path, pneunet(), calculix(), OBSERVATION)}
    for version in ("2.20", "2.21"):
        program.write_text(f"#!/bin/sh\necho 'This is Version {version}'\n")
        program.chmod(0o755)
        found.add(snapshot_path(tmp_path, pneunet(), calculix(), OBSERVATION))
    assert len(found) == 3


class TestTrouble:
    """What the user is told when the program is missing or fails."""

    def test_missing_program_is_named(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("PATH", "")
        with pytest.raises(InputError, match="needs the program 'ccx', .*apt-get install calculix-ccx"):
            calculix().simulate(pneunet(), OBSERVATION)

    @pytest.mark.parametrize(
        ("script", "sentence"),
        [
            ("echo ' *ERROR reading *ELEMENT: nonsense'; exit 201", "'reading .ELEMENT: nonsense'"),
            ("kill -9 $$", "signal 9 killed the program"),
            ("exit 3", "its exit code is 3"),
        ],
    )
    def test_failed_program_is_quoted(
        self, script: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        program = tmp_path / "ccx"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
        with pytest.raises(LabError, match=f"no equilibrium under the weight alone: .*{sentence}"):
            calculix().simulate(pneunet(), OBSERVATION)

    @pytest.mark.parametrize(
        ("fields", "sentence"),
        [
            ({"edge_mm": 0.0}, "fem.edge_mm is 0.0 mm"),
            ({"tolerance": 0.0}, "fem.tolerance is 0.0;"),
            ({"timeout_s": -1.0}, "fem.timeout_s is -1.0 s"),
        ],
    )
    def test_impossible_models_are_refused(self, fields: dict[str, object], sentence: str) -> None:
        with pytest.raises(InputError, match=sentence):
            calculix(**fields)

    @needs_ccx
    def test_what_converged_before_a_burst_is_kept(self) -> None:
        with pytest.raises(SimulationStopped, match=r"up to 1[0-9.]{2,4} kPa, .*finger.max_kpa=300 .*cutbacks") as stop:
            calculix().simulate(balloon(), OBSERVATION)
        kept = stop.value.snapshots
        np.testing.assert_allclose(kept.pressures_kpa, [30, 60, 90, 120])
        assert kept.displacements.shape == (4, 800, 2)
        assert 120 <= kept.provenance["reached_kpa"] < 150

    @needs_ccx
    def test_time_that_is_over_leaves_nothing_behind(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        with pytest.raises((SimulationStopped, LabError), match=r"fem.timeout_s=0.3 s were over"):
            calculix(timeout_s=0.3).simulate(pneunet(), OBSERVATION)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="the stand-in is a shell script")
def test_the_program_is_told_as_many_threads_as_the_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in = tmp_path / "ccx"
    stand_in.write_text(f'#!/bin/sh\necho "$OMP_NUM_THREADS" > {tmp_path}/told\nexit 1\n')
    stand_in.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(7)), raising=False)
    for told, expected in (("5", 5), ("", 7)):
        monkeypatch.setenv("OMP_NUM_THREADS", told)
        with pytest.raises(LabError, match="no equilibrium under the weight alone"):
            calculix().simulate(pneunet(), OBSERVATION)
        assert int((tmp_path / "told").read_text()) == expected


def test_a_small_gap_does_not_matter_to_a_program_without_contact() -> None:
    Model(pneunet(gap_mm=0.05), 6.0, "hex20")


@pytest.fixture(scope="module")
def snapshots(ccx: None) -> Dataset:
    return calculix().simulate(pneunet(), OBSERVATION)


@needs_ccx
class TestAgainstTheSolid:
    def test_agree_under_pressure(self, snapshots: Dataset) -> None:
        """Within 0.03 %: CalculiX integrates the pressure with 2×2 points, too few for it to be exact."""
        peer = solid().simulate(pneunet(), OBSERVATION)
        largest = np.abs(peer.displacements).max()
        np.testing.assert_array_equal(snapshots.domain.points_mm, peer.domain.points_mm)
        np.testing.assert_array_equal(snapshots.pressures_kpa, peer.pressures_kpa)
        np.testing.assert_allclose(snapshots.displacements, peer.displacements, atol=3e-4 * largest)

    @pytest.mark.parametrize(
        ("fields", "gravity"),
        [
            ({}, -9.81),
            ({}, 0.0),
            ({"mu_mpa": [0.22], "alpha": [2.0]}, -9.81),
            ({"mu_mpa": [0.2, 0.04, -0.01], "alpha": [1.0, 5.0, -2.0]}, -9.81),
        ],
    )
    def test_a_law_in_principal_stretches_agrees_at_small_strains(self, fields: dict[str, Any], gravity: float) -> None:
        """Under its own weight and a little pressure, where CalculiX has few digits of such a law."""
        material = registry.plugin("material", "ogden")(**fields)
        soft = pneunet(max_kpa=1.0, gravity_m_s2=[0.0, gravity], material=material)
        ours, theirs = (fem.simulate(soft, Observation(1, 800)) for fem in (solid(), calculix()))
        assert ours.body is not None and theirs.body is not None
        largest = np.abs(ours.displacements).max()
        assert 0.05 < largest < 0.2
        np.testing.assert_allclose(theirs.body.displacements[0], ours.body.displacements[0], atol=1e-4 * largest)
        np.testing.assert_allclose(theirs.displacements, ours.displacements, atol=1e-4 * largest)

    @pytest.mark.parametrize("law", ["yeoh", "mooney_rivlin", "ogden"])
    def test_agree_in_large_bending(self, law: str) -> None:
        """To the digits that CalculiX prints where no pressure acts: 600 times the density.

        The chambers fold up under it, and CalculiX lets their walls pass through each other.
        """
        free = solid(contact="off")
        heavy = pneunet(density_kg_m3=678e3, max_kpa=1e-3, material=registry.plugin("material", law)())
        ours, theirs = (fem.simulate(heavy, Observation(1, 800)).body for fem in (free, calculix(tolerance=1e-4)))
        assert ours is not None and theirs is not None
        assert np.abs(ours.displacements[0]).max() > 30
        np.testing.assert_allclose(theirs.displacements[0], ours.displacements[0], atol=2e-5)

    def test_provenance_says_where_the_numbers_come_from(self, snapshots: Dataset) -> None:
        told = snapshots.provenance
        assert told["finger"]["chambers"] == 2 and told["fem"]["name"] == "calculix"
        assert told["mesh"] == {"elements": 57, "nodes": 472, "degrees_of_freedom": 1172}
        assert told["increments"] >= 10 and told["newton_iterations"] >= told["increments"]
        assert told["cpu_seconds"] > 0 and told["versions"]["calculix"] != "unknown"
        np.testing.assert_allclose(np.array(told["reaction_n"])[[0, 2]], -np.array(told["load_n"])[[0, 2]], atol=1e-4)
        assert told["reached_kpa"] == 20


@needs_ccx
def test_a_finger_that_leans_over_is_named(caplog: pytest.LogCaptureFixture) -> None:
    """Half a finger cannot show it, in CalculiX as little as in the solid."""
    slender = {"chambers": 2, "width_mm": 4.0, "side_wall_mm": 1.0, "height_mm": 30.0, "base_mm": 12.0, "max_kpa": 0.5}
    found = calculix(edge_mm=12.0).simulate(pneunet(**slender, gravity_m_s2=[0.0, -400.0]), Observation(1, 200))
    assert "gives way sideways, by at least" in caplog.text
    assert found.provenance["sideways_unstable_kpa"] == [0.0, 0.5] and not found.provenance["sideways_lean"]["settled"]
    caplog.clear()
    calculix(edge_mm=12.0).simulate(pneunet(max_kpa=0.5), Observation(1, 200))
    assert "sideways" not in caplog.text and "pass through" not in caplog.text
