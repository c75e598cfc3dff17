from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
from meshio.xdmf import TimeSeriesReader

from pgdl_lab.running.paraview import write_face, write_series
from tests.fingers import OBSERVATION, pneunet, solid
from tests.test_surrogate import trained
from tests.trainings import small


def test_series_holds_every_equilibrium(tmp_path: Path) -> None:
    body = solid(element="hex27_p1").simulate(pneunet(chambers=1), OBSERVATION).body
    assert body is not None
    series = write_series(body, tmp_path)
    sets = ElementTree.parse(series).getroot().findall("./Collection/DataSet")
    assert [float(entry.get("timestep", "")) for entry in sets] == body.pressures_kpa.round(9).tolist()
    for number, entry in enumerate(sets):
        mesh = meshio.read(tmp_path / entry.get("file", ""))
        np.testing.assert_allclose(mesh.points, body.domain.points_mm)
        np.testing.assert_allclose(mesh.point_data["displacement_mm"], body.displacements[number])
        assert mesh.cells[0].type == "hexahedron27"
        np.testing.assert_array_equal(mesh.cells[0].data, body.domain.cells)


def test_face_holds_both_fields_at_every_pressure(tmp_path: Path) -> None:
    surrogate, data = trained("pod", tmp_path), small()
    path = tmp_path / "paraview" / "face.xdmf"
    write_face(surrogate, data, path)
    assert sorted(file.name for file in path.parent.iterdir()) == ["face.h5", "face.xdmf"]
    with TimeSeriesReader(path) as file:
        points, cells = file.read_points_cells()
        np.testing.assert_array_equal(points[:, [0, 2]], data.domain.points_mm)
        np.testing.assert_array_equal(cells[0].data, data.domain.cells)
        assert file.num_steps == len(data.pressures_kpa)
        for number, kpa in enumerate(data.pressures_kpa):
            time, fields, _ = file.read_data(number)
            predicted = surrogate.predict(data.domain.points_mm, kpa)
            assert time == kpa
            np.testing.assert_array_equal(fields["fem_mm"][:, [0, 2]], data.displacements[number])
            np.testing.assert_array_equal(fields["surrogate_mm"][:, [0, 2]], predicted)
            np.testing.assert_allclose(fields["difference_mm"][:, [0, 2]], predicted - data.displacements[number])
            assert (fields["error_bar_mm"] > 0).all() and not fields["fem_mm"][:, 1].any()
