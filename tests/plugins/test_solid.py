import meshio
import numpy as np
import pytest

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from tests.fingers import OBSERVATION, pneunet, solid


@pytest.fixture(scope="module")
def snapshots() -> Dataset:
    return solid(element="hex27_p1", estimate_error=True).simulate(pneunet(), OBSERVATION)


def test_coarse_mesh_is_said_to_be_coarse(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("WARNING"):
        coarse = solid(estimate_error=True).simulate(pneunet(chambers=1), OBSERVATION)
    error = coarse.provenance["discretisation_error"]
    assert 0 < error["tip_mm"] <= error["largest_mm"] and error["kpa"] == 20
    assert f"lie {error['tip_mm']:.2g} mm elsewhere at 20 kPa" in caplog.text
    assert solid().simulate(pneunet(chambers=1), OBSERVATION).provenance["discretisation_error"] is None


def test_dataset_as_asked_for(snapshots: Dataset) -> None:
    assert snapshots.displacements.shape == (10, 800, 2)
    np.testing.assert_allclose(snapshots.pressures_kpa, np.arange(2, 21, 2))
    assert np.abs(snapshots.displacements[:, snapshots.domain.clamp]).max() < 1e-12
    tip = snapshots.displacements[:, snapshots.domain.base[-1], 1]
    assert (np.diff(tip) < 0).all()  # a chamber above the channel: the finger bends down as pressure rises


def test_side_face_agrees_with_the_body(snapshots: Dataset) -> None:
    body = snapshots.body
    assert body is not None and body.pressures_kpa[-1] == 20
    corner = np.abs(body.domain.points_mm - [22, 8, 0]).sum(axis=1).argmin()
    np.testing.assert_allclose(body.domain.points_mm[corner], [22, 8, 0], atol=1e-9)
    tip = snapshots.domain.base[-1]
    np.testing.assert_allclose(body.displacements[-1, corner, [0, 2]], snapshots.displacements[-1, tip], atol=1e-9)


def test_provenance_says_where_the_numbers_come_from(snapshots: Dataset) -> None:
    told = snapshots.provenance
    assert told["finger"]["chambers"] == 2 and told["fem"]["element"] == "hex27_p1"
    assert told["mesh"] == {"elements": 57, "nodes": 771, "degrees_of_freedom": 2015}
    assert told["interpolation_error_mm"] <= 1e-5
    np.testing.assert_allclose(np.array(told["reaction_n"])[[0, 2]], -np.array(told["load_n"])[[0, 2]], atol=1e-6)
    assert told["unstable_kpa"] == []
    assert {"python", "numpy", "scipy", "scikit-fem", "pgdl_lab"} <= told["versions"].keys()


@pytest.mark.parametrize("element", ["hex20", "hex27_p1"])
def test_cells_are_valid_in_the_order_of_vtk(element: str) -> None:
    """Corners, middles of edges and, with 27 nodes, of faces lie where VTK wants them; meshio knows the name."""
    body = solid(element=element).simulate(pneunet(chambers=1), OBSERVATION).body
    assert body is not None
    corners, extra = body.domain.points_mm[body.domain.cells[:, :8]], body.domain.points_mm[body.domain.cells[:, 8:]]
    edges = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
    for place, (start, stop) in enumerate(edges):
        np.testing.assert_allclose(extra[:, place], (corners[:, start] + corners[:, stop]) / 2, atol=1e-9)
    along, across, up = (corners[:, i] - corners[:, 0] for i in (1, 3, 4))
    assert (np.einsum("ei,ei->e", np.cross(along, across), up) > 0).all()
    if element == "hex27_p1":
        faces = [(0, 3, 7, 4), (1, 2, 6, 5), (0, 1, 5, 4), (3, 2, 6, 7), (0, 1, 2, 3), (4, 5, 6, 7)]
        for place, face in enumerate(faces):
            np.testing.assert_allclose(extra[:, 12 + place], corners[:, face].mean(axis=1), atol=1e-9)
        np.testing.assert_allclose(extra[:, 18], corners.mean(axis=1), atol=1e-9)
    assert meshio.CellBlock(body.domain.cell_type, body.domain.cells).dim == 3


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"edge_mm": 0.0}, "fem.edge_mm is 0.0 mm"),
        ({"newton_mm": -1.0}, "fem.newton_mm is -1.0 mm"),
        ({"element": "tet4"}, "fem.element is 'tet4'; choose one of auto, hex20, hex27"),
    ],
)
def test_impossible_models_are_refused(fields: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        solid(**fields)
