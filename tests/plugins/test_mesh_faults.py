"""Faults of mesh files that users have: put right and said, or refused in one sentence before anything is computed."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest

from pgdl_lab.core import registry
from pgdl_lab.core.observation import Observation
from tests.fingers import from_file, refusal, solid
from tests.meshes import Array, Index, bricks, chamber, groups, inside, plain, save, skin, swapped, tetrahedra

registry.discover()


def with_facets(path: Path, points: Array, cells: Index, facets: Index, named: dict[str, Any]) -> Path:
    """As `save`, with the facets given."""
    blocks = [("hexahedron", cells), ("quad", facets)]
    arrays: dict[str, Any] = {name: [np.zeros(len(cells)), 1.0 * mask] for name, mask in named.items()}
    meshio.write_points_cells(path, points, blocks, cell_data=arrays)
    return path


# Elements


@pytest.mark.parametrize("again", [slice(27, 28), slice(None)], ids=["one", "all"])
def test_elements_that_are_there_twice_count_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, again: slice
) -> None:
    points, cells, named = plain()
    doubled = np.vstack([cells, cells[again][:, [1, 2, 3, 0, 5, 6, 7, 4]]])
    with caplog.at_level("INFO", "pgdl_lab"):
        mesh = from_file(with_facets(tmp_path / "a.vtu", points, doubled, skin(cells), named)).mesh(1.0)
    assert mesh.nelements == 66
    copies = len(doubled) - 66
    assert f"{copies} of {len(doubled)} elements of {tmp_path / 'a.vtu'} are there twice: taken once." in caplog.text


def test_volume_in_two_groups_of_gmsh_counts_once(tmp_path: Path) -> None:
    """Format 2.2 writes an element once for each of its groups."""
    points, cells, named = plain()
    facets = skin(cells)
    blocks = [("hexahedron", np.vstack([cells, cells])), *(("quad", facets[mask]) for mask in named.values())]
    tags = [
        np.repeat([1, 2], len(cells)),
        *(np.full(int(mask.sum()), 3 + at) for at, mask in enumerate(named.values())),
    ]
    meshio.write(
        tmp_path / "a.msh",
        meshio.Mesh(
            points,
            blocks,
            cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
            field_data={"body": [1, 3], "rubber": [2, 3], "clamp": [3, 2], "cavity": [4, 2]},
        ),
        file_format="gmsh22",
    )
    assert from_file(tmp_path / "a.msh").mesh(1.0).nelements == 66


def test_facet_of_three_elements_is_refused(tmp_path: Path) -> None:
    points, cells, named = plain()
    points = np.vstack([points, points[cells[0, 4:]] + [0, 0, 3.0]])
    cells = np.vstack(
        [cells, [*cells[0, 4:], *range(len(points) - 4, len(points))]]
    )  # lies over another above the first
    said = refusal(with_facets(tmp_path / "a.vtu", points, cells, skin(cells[:-1]), named))
    assert re.search(
        r"\d+ facets of .* belong to more than two elements, the first near \(2\.5, .*\) mm: .* overlap", said
    )


@pytest.mark.parametrize("split", [False, True], ids=["hexahedra", "tetrahedra"])
def test_all_elements_left_handed_are_reversed_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, split: bool
) -> None:
    points, cells = bricks()
    cells = tetrahedra(cells) if split else cells
    named = groups(points, skin(cells))
    straight, turned = (
        from_file(save(tmp_path / f"{at}.vtu", points, each, named)) for at, each in enumerate((cells, swapped(cells)))
    )
    observed = Observation(1, 200)
    with caplog.at_level("INFO", "pgdl_lab"):
        fem = solid(element="tet10" if split else "hex20", interpolation_mm=1e-2)
        one, other = (fem.simulate(finger, observed) for finger in (straight, turned))
    assert caplog.text.count(f"All elements of {tmp_path / '1.vtu'} are left-handed") == 1
    assert one.body is not None and other.body is not None
    assert np.abs(one.displacements).max() > 1e-3
    np.testing.assert_allclose(other.displacements, one.displacements, atol=1e-9)


@pytest.mark.parametrize("most", [False, True], ids=["few", "most"])
def test_a_part_of_the_elements_inverted_is_a_fault(tmp_path: Path, most: bool) -> None:
    points, cells, named = plain()
    wrong = np.arange(len(cells)) < 5
    mixed = np.where((wrong ^ most)[:, None], swapped(cells), cells)
    said = refusal(save(tmp_path / "a.vtu", points, mixed, named))
    assert re.search(r"^5 of 66 elements of .* are inverted against the rest or flat, the first near \(2\.5, ", said)


def test_nodes_that_are_not_merged_are_counted_and_placed(tmp_path: Path) -> None:
    points, cells, _ = plain()
    seam = np.flatnonzero((np.abs(points[:, 0] - 20) < 1e-6) & (points[:, 2] < 4.9))
    number = np.arange(len(points))
    number[seam] = len(points) + np.arange(len(seam))
    right = points[cells].mean(axis=1)[:, 0] > 20
    parted = np.where(right[:, None], number[cells], cells)
    both = np.vstack([points, points[seam]])
    said = refusal(save(tmp_path / "a.vtu", both, parted, groups(both, skin(parted))))
    assert re.search(
        r"^4 nodes of .* coincide with another one, the first near \(20, -6, 0\) mm, .*: merge nodes", said
    )


def test_surface_that_crosses_itself_is_refused_where_it_does(tmp_path: Path) -> None:
    """The upper prong of a fork dips into the lower one."""
    points, cells = bricks(
        lambda i, j, k: (k == 1 and i >= 3) or (i, j, k) == (1, 1, 1), ys=(-10, -3, 3, 10), zs=(0, 4, 8, 12)
    )
    middles = points[skin(cells)].mean(axis=1)
    named = {"clamp": middles[:, 0] < 1e-6, "cavity": inside(middles, (5, -3, 4), (10, 3, 8))}
    dip = (points[:, 0] > 19) & (points[:, 2] > 7.9) & (np.abs(points[:, 1]) < 3.01)
    dipped = points - 4.5 * dip[:, None] * np.array([0, 0, 1])
    said = refusal(save(tmp_path / "a.vtu", dipped, cells, named))
    found = re.search(r"passes through itself near \((\S+), (\S+), (\S+)\) mm before anything acts on it", said)
    assert found is not None
    x, y, z = map(float, found.groups())
    assert 15 <= x <= 40 and -10 <= y <= 10 and 3 <= z <= 8.5
    assert from_file(save(tmp_path / "b.vtu", points, cells, named)).mesh(1.0).nelements == len(cells)


# Chambers


def two_chambers(i: int, j: int, k: int) -> bool:
    return chamber(i, j, k) and i != 3


def test_second_chamber_in_no_group_is_asked_about(tmp_path: Path) -> None:
    points, cells = bricks(two_chambers)
    middles = points[skin(cells)].mean(axis=1)
    named = {"clamp": middles[:, 0] < 1e-6, "cavity": inside(middles, (5, -3, 5), (15, 3, 9))}
    (told,) = from_file(save(tmp_path / "a.vtu", points, cells, named)).doubts()
    assert (
        "has 1 more closed inner surface in no group of finger.cavity, 360 mm³ around (27.5, 0, 7) mm, where no" in told
    )
    named["cavity"] |= inside(middles, (20, -3, 5), (35, 3, 9))
    assert not from_file(save(tmp_path / "b.vtu", points, cells, named)).doubts()


def test_cavity_that_is_an_outer_surface_beside_a_chamber_is_refused(tmp_path: Path) -> None:
    """An outer surface is closed too where the clamp closes it."""
    points, cells, named = plain()
    said = refusal(save(tmp_path / "a.vtu", points, cells, {**named, "cavity": ~named["clamp"]}))
    assert "encloses no air around" in said


# Files


def vtu(path: Path, points: Array, cells: Index, kind: int, field: str = "") -> Path:
    """A file as VTK writes it, in plain text."""

    def array(name: str, dtype: str, values: Any, more: str = "") -> str:
        text = " ".join(map(str, np.ravel(values).tolist()))
        return f'<DataArray type="{dtype}" Name="{name}" format="ascii"{more}>{text}</DataArray>'

    path.write_text(
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>'
        f'{field}<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}"><Points>'
        + array("places", "Float64", points, ' NumberOfComponents="3"')
        + "</Points><Cells>"
        + array("connectivity", "Int64", cells)
        + array("offsets", "Int64", cells.shape[1] * np.arange(1, len(cells) + 1))
        + array("types", "UInt8", np.full(len(cells), kind))
        + "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )
    return path


def test_voxels_are_named(tmp_path: Path) -> None:
    points, cells = bricks()
    said = refusal(vtu(tmp_path / "a.vtu", points, cells[:, [0, 1, 3, 2, 4, 5, 7, 6]], 11))
    assert "has cells that meshio leaves out (VTK's type 11, voxels)" in said and said.endswith("to hexahedra.")


def test_text_in_a_file_of_vtk_is_named(tmp_path: Path) -> None:
    points, cells = bricks()
    author = '<FieldData><Array type="String" Name="author" format="ascii">109 101 0 </Array></FieldData>'
    said = refusal(vtu(tmp_path / "a.vtu", points, cells, 12, author))
    assert (
        "holds text in the array 'author', which meshio cannot read (meshio says 'Illegal data type 'String'')" in said
    )
    assert "export it" not in said


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("a.inp", "*Node\n1, 0, 0, 0\n*Element, type=C3D8T\n1, 1\n", "Element type not available: C3D8T"),
        (
            "a.vtu",
            '<VTKFile type="ImageData" version="0.1"></VTKFile>',
            "Expected type UnstructuredGrid, found ImageData",
        ),
        ("a.msh", "$MeshFormat\n3.9 0 8\n$EndMeshFormat\n", "Need mesh format in"),
        ("a.xyz", "nothing", "ReadError: Could not deduce file format from path"),
    ],
)
def test_reason_of_meshio_is_told(tmp_path: Path, name: str, text: str, why: str) -> None:
    (tmp_path / name).write_text(text)
    said = refusal(tmp_path / name)
    assert "cannot be read as a mesh (meshio says '" in said and why in said
    own = {"inp": "Abaqus", "vtu": "VTK", "msh": "Gmsh"}.get(name[2:], "nothing")
    assert own not in said.rpartition(": export it again, or as one of ")[2]


def test_pointer_in_the_place_of_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.vtk").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    assert "is a pointer of Git LFS in the place of the mesh: fetch it by 'git lfs pull'." in refusal(
        tmp_path / "a.vtk"
    )


def test_small_body_is_asked_about(tmp_path: Path) -> None:
    points, cells, named = plain()
    (told,) = from_file(save(tmp_path / "a.vtu", points * 0.2, cells, named)).doubts()
    assert told.endswith("a.vtu is only 8 mm large: is its unit of length finger.unit=mm?")
    said = refusal(save(tmp_path / "b.vtu", points * 1e-3, cells, named))
    assert "is 0.04 × 0.012 × 0.012 mm large, which is no finger: finger.unit=m would make it a finger" in said


# Files of others


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda file: file.create_dataset("more", (10**9,), "f8", chunks=(1000,)), "ask for 8,000,.* explain at most"),
        (lambda file: file.update(more=h5py.ExternalLink("/etc/other.h5", "/x")), "'more' is a link to the file '/etc"),
        (lambda file: file.create_dataset("more", (9,), "f8", external=[("/etc/passwd", 0, 72)]), "in other files"),
        (lambda file: file.create_dataset("more", (9,), h5py.ref_dtype), "'more' holds objects"),
    ],
)
def test_numbers_lie_in_the_file_or_beside_it(tmp_path: Path, change: Callable[[h5py.File], Any], words: str) -> None:
    path = save(tmp_path / "a.xdmf", *plain())
    whole = shutil.copytree(tmp_path, tmp_path / "whole")
    assert from_file(whole / "a.xdmf").mesh(1.0).nelements == 66
    other = path.read_text().replace("a.h5", "/tmp/a.h5")
    (tmp_path / "b.xdmf").write_text(other)
    assert "its numbers lie in another folder, in '/tmp/a.h5'" in refusal(tmp_path / "b.xdmf")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        change(file)
    assert re.search(rf"a\.xdmf is not taken as a mesh: .*{words}", refusal(path))


# Advice


@pytest.mark.parametrize("contact", ["auto", "off"])
def test_advice_knows_the_finger_and_the_present_setting(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, contact: str
) -> None:
    from pgdl_lab.mechanics.finite_strain import Model

    points, cells, named = plain()
    finger = from_file(save(tmp_path / "a.vtu", points, cells, named), gravity_m_s2=[0.0, 0.0])
    crossed = {"acted": False, "smallest_gap_mm": None, "penetration_kpa": [0.5]}
    monkeypatch.setattr(Model, "contact_report", lambda *_: crossed)
    monkeypatch.setattr(Model, "discretisation_error", lambda *_: None)
    fem = solid(element="hex27_p1", contact=contact, estimate_error=True, interpolation_mm=1e-2)
    fem.simulate(finger, Observation(1, 200))
    assert "edge_mm" not in caplog.text and f"mesh {finger.path} finer and compare." in caplog.text  # type: ignore[attr-defined]
    assert f"fem.contact={contact}" not in caplog.text
    assert f"fem.contact={'on' if contact == 'auto' else 'auto'}" in caplog.text


def test_advice_on_the_mesh_of_a_family(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    from pgdl_lab.mechanics.finite_strain import Model
    from tests.fingers import pneunet

    monkeypatch.setattr(Model, "discretisation_error", lambda *_: None)
    solid(element="hex20", estimate_error=True).simulate(pneunet(chambers=1, max_kpa=1.0), Observation(1, 200))
    assert "lower fem.edge_mm=6 and compare, or choose fem.element=hex27_p1." in caplog.text
