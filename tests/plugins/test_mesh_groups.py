"""Groups of mesh files, whatever a format calls them: by name, by number, and what of them is told."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from pgdl_lab.core import registry
from tests.conftest import composed
from tests.fingers import from_file, refusal
from tests.meshes import Array, Index, bricks, groups, plain, save, skin, swapped, tetrahedra

registry.discover()


def test_empty_group_and_group_of_volumes_are_told_apart(tmp_path: Path) -> None:
    points, cells, named = plain()
    empty = save(tmp_path / "a.vtu", points, cells, {**named, "clamp": 0 * named["clamp"]})
    said = refusal(empty)
    assert "The group 'clamp' of" in said and "holds nothing, but finger.clamp needs facets or nodes" in said
    assert "cavity (26 facets), clamp (nothing)" in said
    blocks: list[Any] = [("hexahedron", cells), ("quad", skin(cells))]
    volumes = {"clamp": [np.ones(66), np.zeros(len(skin(cells)))], "cavity": [np.zeros(66), 1.0 * named["cavity"]]}
    meshio.write_points_cells(tmp_path / "b.vtu", points, blocks, cell_data=volumes)
    assert "The group 'clamp' of" in (said := refusal(tmp_path / "b.vtu")) and "holds 66 volumes, but" in said


@pytest.mark.parametrize("number", ["3", 3])
def test_physical_groups_without_names_go_by_number(tmp_path: Path, number: Any) -> None:
    points, cells, named = plain()
    facets = skin(cells)
    tags = [np.full(len(cells), 9), np.where(named["clamp"], 3, np.where(named["cavity"], 4, 5))]
    raw = meshio.Mesh(points, [("hexahedron", cells), ("quad", facets)])
    raw.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    meshio.write(tmp_path / "a.msh", raw, file_format="gmsh22")
    config = composed("finger=mesh", f"finger.path={tmp_path / 'a.msh'}", f"finger.clamp={number}", "finger.cavity=4")
    mesh = from_file(tmp_path / "a.msh", clamp=config.finger.clamp, cavity=config.finger.cavity).mesh(1.0)
    assert [len(mesh.boundaries[name]) for name in ("clamp", "cavity")] == [9, 26]
    assert "its groups are 3 (9 facets), 4 (26 facets), 5 (" in refusal(tmp_path / "a.msh")


def test_a_number_of_gmsh_is_another_one_for_volumes(tmp_path: Path) -> None:
    points, cells, named = plain()
    tags = [np.full(len(cells), 3), np.where(named["clamp"], 3, np.where(named["cavity"], 4, 5))]
    raw = meshio.Mesh(points, [("hexahedron", cells), ("quad", skin(cells))])
    raw.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    raw.field_data = {"body": np.array([3, 3]), "clamp": np.array([3, 2]), "cavity": np.array([4, 2])}
    meshio.write(tmp_path / "a.msh", raw, file_format="gmsh22")
    assert len(from_file(tmp_path / "a.msh").mesh(1.0).boundaries["clamp"]) == 9
    said = refusal(tmp_path / "a.msh", clamp="body")
    assert "The group 'body' of" in said and "holds 66 volumes, but finger.clamp needs facets" in said
    assert "body (66 volumes), cavity (26 facets), clamp (9 facets), 5 (" in said


def test_families_of_salome_are_groups(tmp_path: Path) -> None:
    """Salome marks each facet with the number of a family that lists its groups, and writes left-handed elements."""
    points, cells, named = plain()
    facets = skin(cells)
    families = np.where(named["clamp"], -7, np.where(named["cavity"], -8, 0))
    families[np.flatnonzero(named["clamp"])[0]] = -9  # in two groups
    raw: Any = meshio.Mesh(points, [("hexahedron", swapped(cells)), ("quad", facets)])
    raw.cell_data = {"cell_tags": [np.zeros(len(cells), dtype=int), families]}
    raw.cell_tags = {-7: ["clamp"], -8: ["cavity"], -9: ["clamp", "corner"]}
    raw.write(tmp_path / "a.med")
    mesh = from_file(tmp_path / "a.med").mesh(1.0)
    assert [len(mesh.boundaries[name]) for name in ("clamp", "cavity")] == [9, 26]
    assert "cavity (26 facets), clamp (9 facets), corner (1 facets)." in refusal(tmp_path / "a.med", clamp="root")


FACES = {  # of a hexahedron and of a tetrahedron, by the numbers of Abaqus; corners from 1
    8: ["1234", "5678", "1265", "2376", "3487", "4158"],
    4: ["123", "142", "243", "341"],
}


def abaqus(path: Path, points: Array, cells: Index, named: dict[str, Any], sets: bool) -> Path:
    """An input file as Abaqus writes it: its surfaces are faces of elements, one by one or in sets."""
    kind = {8: "C3D8R", 4: "C3D4"}[cells.shape[1]]
    lines = ["*Heading", "** made by hand", "*Node"]
    lines += [f"{number}, {', '.join(map(repr, map(float, point)))}" for number, point in enumerate(points, start=10)]
    lines.append(f"*Element, type={kind}")
    lines += [f"{number}, {', '.join(map(str, cell + 10))}" for number, cell in enumerate(cells, start=1000)]
    facets = skin(cells)
    for name, mask in named.items():
        wanted = {tuple(sorted(facet)) for facet in facets[mask].tolist()}
        owners: dict[int, list[int]] = {}
        for number, cell in enumerate(cells.tolist(), start=1000):
            for face, corners in enumerate(FACES[len(cell)], start=1):
                if tuple(sorted(cell[int(corner) - 1] for corner in corners)) in wanted:
                    owners.setdefault(face, []).append(number)
        rows = [f"{number}, S{face}" for face, numbers in owners.items() for number in numbers]
        if sets:
            for face, numbers in owners.items():
                lines += [f"*Elset, elset=_{name}_S{face}, internal", *(f"{number}," for number in numbers)]
            rows = [f"_{name.upper()}_S{face}, S{face}" for face in owners]  # names are the same in either case
        lines += [f"*Surface, type=ELEMENT, name={name}", *rows]
    path.write_text("\n".join([*lines, "*Step", "*End Step"]) + "\n")
    return path


@pytest.mark.parametrize("sets", [False, True], ids=["elements", "sets"])
@pytest.mark.parametrize("split", [False, True], ids=["hexahedra", "tetrahedra"])
def test_surfaces_of_abaqus_are_groups(tmp_path: Path, split: bool, sets: bool) -> None:
    points, cells = bricks()
    cells = tetrahedra(cells) if split else cells
    named = groups(points, skin(cells))
    mesh = from_file(abaqus(tmp_path / "a.inp", points, cells, named, sets)).mesh(1.0)
    for name, mask in named.items():
        middles = points[skin(cells)[mask]].mean(axis=1)
        found = mesh.p[:, mesh.facets[:, mesh.boundaries[name]]].mean(axis=1).T - [0, 0, 0]
        np.testing.assert_allclose(_sorted(found), _sorted(middles), atol=1e-9)
    said = refusal(tmp_path / "a.inp", clamp="root")
    assert f"cavity ({int(named['cavity'].sum())} facets), clamp ({int(named['clamp'].sum())} facets)" in said


def _sorted(places: Array) -> Array:
    rounded: Array = places.round(6) + 0.0
    return rounded[np.lexsort(rounded.T)]


def test_surface_of_abaqus_that_names_nothing_holds_nothing(tmp_path: Path) -> None:
    points, cells, named = plain()
    path = abaqus(tmp_path / "a.inp", points, cells, named, sets=False)
    path.write_text(path.read_text() + "*Surface, type=ELEMENT, name=root\nnowhere, S1\n77, S9\n1000,\n")
    assert "The group 'root' of" in (said := refusal(path, clamp="root")) and "holds nothing" in said


def gmsh41(path: Path, points: Array, blocks: Sequence[tuple[int, int, Index, int | None]]) -> Path:
    """A file in format 4.1 of Gmsh; each block has its dimension, its kind, its cells and its physical group."""
    entities = {
        dimension: [at for at, block in enumerate(blocks, start=1) if block[0] == dimension] for dimension in (2, 3)
    }
    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$Entities", f"0 0 {len(entities[2])} {len(entities[3])}"]
    for dimension in (2, 3):
        for at in entities[dimension]:
            group = blocks[at - 1][3]
            lines.append(f"{at} 0 0 0 1 1 1 {'0' if group is None else f'1 {group}'} 0")
    lines += ["$EndEntities", "$Nodes", f"1 {len(points)} 1 {len(points)}", f"3 {entities[3][0]} 0 {len(points)}"]
    lines += [str(number) for number in range(1, len(points) + 1)]
    lines += [" ".join(map(repr, map(float, point))) for point in points]
    count = sum(len(block[2]) for block in blocks)
    lines += ["$EndNodes", "$Elements", f"{len(blocks)} {count} 1 {count}"]
    number = 0
    for at, (dimension, kind, cells, _) in enumerate(blocks, start=1):
        lines.append(f"{dimension} {at} {kind} {len(cells)}")
        for cell in cells:
            number += 1
            lines.append(f"{number} {' '.join(map(str, cell + 1))}")
    path.write_text("\n".join([*lines, "$EndElements"]) + "\n")
    return path


def test_groups_of_gmsh_that_are_not_everywhere(tmp_path: Path) -> None:
    points, cells, named = plain()
    facets = skin(cells)
    rest = facets[~named["clamp"] & ~named["cavity"]]
    surfaces = [(2, 3, facets[named["clamp"]], 3), (2, 3, facets[named["cavity"]], 4)]
    all_in = gmsh41(tmp_path / "a.msh", points, [*surfaces, (2, 3, rest, 5), (3, 5, cells, 6)])
    assert from_file(all_in, clamp="3", cavity="4").mesh(1.0).nelements == 66
    some = refusal(gmsh41(tmp_path / "b.msh", points, [*surfaces, (2, 3, rest, None), (3, 5, cells, 6)]), clamp="3")
    assert "has elements in physical groups and others in none, which meshio cannot read in format 4.1" in some
    assert "Mesh.MshFileVersion=2.2" in some
    no_volume = meshio.Mesh(points, [("quad", facets)])
    no_volume.cell_data = {name: [np.where(named["clamp"], 3, 4)] for name in ("gmsh:physical", "gmsh:geometrical")}
    meshio.write(tmp_path / "c.msh", no_volume, file_format="gmsh22")
    assert "put the volume in a physical group, as Gmsh leaves out what is in none" in refusal(tmp_path / "c.msh")
    left_out = save(tmp_path / "d.vtu", points, cells[1:], None)  # its facets are still there
    raw = meshio.read(left_out)
    raw.cells[1].data = np.vstack([raw.cells[1].data, facets[named["clamp"]]])
    for name in ("clamp", "cavity"):
        marked = np.full(int(named["clamp"].sum()), float(name == "clamp"))
        raw.cell_data[name][1] = np.concatenate([raw.cell_data[name][1], marked])
    raw.write(left_out)
    assert "are not on the surface of the volume mesh" in (said := refusal(left_out))
    assert "Gmsh leaves out those that are in no physical group" in said
