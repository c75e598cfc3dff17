from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from pgdl_lab.paraview import write_series
from tests.fingers import OBSERVATION, pneunet, solid


def test_series_holds_every_equilibrium(tmp_path: Path) -> None:
    body = solid(element="hex27_p1").simulate(pneunet(chambers=1), OBSERVATION).body
    assert body is not None
    series = write_series(body, tmp_path)
    sets = ElementTree.parse(series).getroot().findall("./Collection/DataSet")
    assert [float(entry.get("timestep", "")) for entry in sets] == body.pressures_kpa.round(9).tolist()
    for number, entry in enumerate(sets):
        mesh = meshio.read(tmp_path / entry.get("file", ""))
        np.testing.assert_allclose(mesh.points, body.positions)
        np.testing.assert_allclose(mesh.point_data["displacement_mm"], body.displacements[number])
        assert mesh.cells[0].type == "hexahedron27"
        np.testing.assert_array_equal(mesh.cells[0].data, body.cells)
