"""A finger from a mesh file: the same body gives the same numbers, and what is no finger is refused in a sentence."""

import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from skfem import Mesh, MeshHex, MeshTet

from pgdl_lab.core import registry
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.elements import ELEMENTS, discretise
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.meshcavity import chambers
from pgdl_lab.mechanics.vtk import vtk_cells
from pgdl_lab.running.cache import snapshot_path
from tests.conftest import CHECKOUT
from tests.fingers import OBSERVATION, pneunet, solid, tetrahedra

FEW = replace(OBSERVATION, snapshots=2, points=500)


def from_file(path: Path, **fields: Any) -> Finger:
    finger: Finger = registry.plugin("finger", "mesh")(**{"path": str(path), "max_kpa": 20.0, **fields})
    return finger


def as_meshio(mesh: Mesh, quadratic: bool = False) -> meshio.Mesh:
    """The elements and one block of facets for each named boundary."""
    tetrahedral = isinstance(mesh, MeshTet)
    body = discretise(mesh, ELEMENTS["tet10" if tetrahedral else "hex20"])
    name, cells = vtk_cells(body)
    if not quadratic:
        name, cells = ("tetra", cells[:, :4]) if tetrahedral else ("hexahedron", cells[:, :8])
    corners = body.basis.nodal_dofs[0]
    named = [corners[mesh.facets[:, facets]].T for facets in mesh.boundaries.values()]
    blocks = [(name, cells), *(("triangle" if tetrahedral else "quad", facets) for facets in named)]
    return meshio.Mesh(body.positions, blocks)


def to_gmsh(mesh: Mesh, path: Path, quadratic: bool = False) -> Path:
    raw = as_meshio(mesh, quadratic)
    raw.field_data = {name: np.array([tag, 2]) for tag, name in enumerate(mesh.boundaries, start=1)}
    tags = [np.full(len(block.data), tag) for tag, block in enumerate(raw.cells)]
    raw.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    raw.write(path, file_format="gmsh22")
    return path


def to_vtu(mesh: Mesh, path: Path) -> Path:
    """Groups as arrays on all cells: 1 on facets of the group."""
    raw = as_meshio(mesh)
    for place, name in enumerate(mesh.boundaries, start=1):
        raw.cell_data[name] = [np.full(len(block.data), int(at == place)) for at, block in enumerate(raw.cells)]
    raw.write(path)
    return path


def to_abaqus(mesh: Mesh, path: Path) -> Path:
    """Groups as sets of nodes, and no facets at all."""
    raw = as_meshio(mesh)
    raw.point_sets = {name: np.unique(block.data) for name, block in zip(mesh.boundaries, raw.cells[1:], strict=True)}
    raw.cells = raw.cells[:1]
    raw.write(path)
    return path


def small() -> Mesh:
    return pneunet().mesh(6.0)


def centres(mesh: Mesh, name: str) -> Any:
    """Middles of the facets of a named boundary, in an order of their own."""
    middles = mesh.p[:, mesh.facets[:, mesh.boundaries[name]]].mean(axis=1).T.round(9) + 0.0
    return middles[np.lexsort(middles.T)]


def deviation(one: Dataset, other: Dataset) -> float:
    """Largest difference between displacements of the same nodes at the highest pressure [mm]."""
    from scipy.spatial import cKDTree

    assert one.body is not None and other.body is not None
    distance, node = cKDTree(one.body.domain.points_mm).query(other.body.domain.points_mm)
    assert distance.max() < 1e-9
    return float(np.abs(one.body.displacements[-1][node] - other.body.displacements[-1]).max())


@pytest.mark.parametrize("element", ["hex20", "auto"])
def test_extruded_finger_through_a_file_gives_the_same_displacements(tmp_path: Path, element: str) -> None:
    direct = solid(element=element).simulate(pneunet(), FEW)
    read = solid(element=element).simulate(from_file(to_gmsh(small(), tmp_path / "a.msh")), FEW)
    assert deviation(direct, read) < 1e-10
    assert read.displacements.shape == (2, 500, 2)
    np.testing.assert_allclose(read.displacements[:, read.domain.clamp], 0, atol=1e-9)


def test_whole_finger_bends_as_its_half(tmp_path: Path) -> None:
    half = small()
    mirrored = MeshHex(half.p * [[1], [-1], [1]], half.t)
    whole = half + mirrored  # merges the nodes of the plane
    facets = whole.boundary_facets()
    x, y, z = whole.p[:, whole.facets[:, facets]].mean(axis=1)
    named = {}
    for name in ("clamp", "cavity"):
        named[name] = [
            facet
            for facet, place in zip(facets, np.column_stack([x, np.abs(y), z]), strict=True)
            if np.isclose(centres(half, name), place, atol=1e-6).all(axis=1).any()
        ]
    path = to_gmsh(whole.with_boundaries({name: np.array(found) for name, found in named.items()}), tmp_path / "a.msh")
    one, other = (solid().simulate(finger, FEW) for finger in (from_file(path), pneunet()))
    assert deviation(one, other) < 1e-8
    reaction, load = np.array(one.provenance["reaction_n"]), np.array(one.provenance["load_n"])
    np.testing.assert_allclose(reaction + load, 0, atol=1e-6)


def test_tetrahedra_converge_to_hexahedra(tmp_path: Path) -> None:
    finger, few = pneunet(max_kpa=1.0, gravity_m_s2=[0.0, 0.0]), replace(FEW, snapshots=1)

    loose = {"contact": "off", "interpolation_mm": 1e-3}

    def extremes(shots: Dataset) -> Any:
        return np.abs(shots.displacements).max(axis=(0, 1))

    reference = extremes(solid(edge_mm=2.0, element="hex27_p1", **loose).simulate(finger, few))
    errors = {}
    for edge in (6.0, 3.0):
        path = to_gmsh(tetrahedra(finger.mesh(edge)), tmp_path / f"{edge}.msh")
        shots = solid(element="tet15_p1", **loose).simulate(from_file(path, max_kpa=1.0, gravity_m_s2=[0.0, 0.0]), few)
        assert shots.body is not None and shots.body.domain.cell_type == "tetra10"
        errors[edge] = float(np.abs(extremes(shots) / reference - 1).max())
    assert errors[3.0] < 0.06 and errors[3.0] < errors[6.0] / 1.8, errors
    constant = solid(element="auto", **loose).simulate(from_file(path, max_kpa=1.0, gravity_m_s2=[0.0, 0.0]), few)
    assert constant.provenance["element"] == "tet10_p0"
    assert np.abs(extremes(constant) / reference - 1).max() < 0.08


@pytest.mark.parametrize("write", [to_gmsh, to_vtu, to_abaqus])
@pytest.mark.parametrize("split", [False, True], ids=["hexahedra", "tetrahedra"])
def test_groups_of_all_formats(tmp_path: Path, write: Callable[..., Path], split: bool) -> None:
    mesh = tetrahedra(small()) if split else small()
    suffix = {to_gmsh: "msh", to_vtu: "vtu", to_abaqus: "inp"}[write]
    read = from_file(write(mesh, tmp_path / f"a.{suffix}")).mesh(1.0)
    assert read.nelements == mesh.nelements
    for name in mesh.boundaries:
        np.testing.assert_allclose(centres(read, name), centres(mesh, name), atol=1e-7)


@pytest.mark.parametrize("split", [False, True], ids=["hexahedra", "tetrahedra"])
def test_quadratic_elements_and_other_units_and_places(tmp_path: Path, split: bool) -> None:
    mesh = tetrahedra(small()) if split else small()
    moved = mesh.scaled(1e-3).translated([0.3, -0.2, 0.1])
    read = from_file(to_gmsh(moved, tmp_path / "a.msh", quadratic=True), unit="m").mesh(1.0)
    assert read.p.shape == mesh.p.shape
    np.testing.assert_allclose(read.p.min(axis=1), 0, atol=1e-9)
    (chamber,) = chambers(read, read.boundaries["cavity"])
    assert chamber.volume_mm3 == pytest.approx((2 * 4.5 * 11 + 7 * 2) * 5)


def test_curved_quadratic_edges_are_told(tmp_path: Path) -> None:
    raw = as_meshio(small(), quadratic=True)
    middle = raw.cells[0].data[0, 9]
    raw.points[middle] += 0.5
    raw.point_data = {
        name: np.isin(np.arange(len(raw.points)), block.data).astype(int)
        for name, block in zip(small().boundaries, raw.cells[1:], strict=True)
    }
    raw.write(tmp_path / "a.vtu")
    (told,) = from_file(tmp_path / "a.vtu").doubts()
    assert "the edges are taken as straight" in told


@pytest.mark.parametrize("count", [60, 500, 4439])
def test_side_face(tmp_path: Path, count: int) -> None:
    finger = from_file(to_gmsh(tetrahedra(small()), tmp_path / "a.msh"))
    face = finger.face(count)
    assert face.domain.points_mm.shape == (count, 2)
    np.testing.assert_allclose(face.y_mm, 8.0)
    corners = face.domain.points_mm[face.domain.cells]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2
    assert area == pytest.approx(2 * 10.5 * 17 + 8)
    np.testing.assert_allclose(face.domain.points_mm[face.domain.base, 1], 0, atol=1e-6)
    np.testing.assert_allclose(face.domain.points_mm[face.domain.base][[0, -1], 0], [0, 22], atol=1e-6)
    np.testing.assert_allclose(face.domain.points_mm[face.domain.clamp, 0], 0, atol=1e-6)
    np.testing.assert_allclose(np.ptp(face.domain.points_mm[face.domain.clamp, 1]), 17)


def test_slanting_side_face_is_observed_where_it_is(tmp_path: Path) -> None:
    mesh = small()
    narrow = (
        mesh.p * [[1], [1], [1]] * np.vstack([np.ones(mesh.p.shape[1]), 1 - mesh.p[2] / 100, np.ones(mesh.p.shape[1])])
    )
    slanted = replace(mesh, doflocs=narrow)
    finger = from_file(to_gmsh(slanted, tmp_path / "a.msh"), max_kpa=1.0)
    face = finger.face(400)
    np.testing.assert_allclose(face.y_mm, 8 * (1 - face.domain.points_mm[:, 1] / 100), atol=1e-6)
    shots = solid().simulate(finger, replace(FEW, snapshots=1, points=400))
    assert np.isfinite(shots.displacements).all()


def test_too_few_points_for_the_outline(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"observation.points is 5, but the outline of this finger alone needs \d+"):
        from_file(to_gmsh(small(), tmp_path / "a.msh")).face(5)


@pytest.mark.parametrize("suffix", ["msh", "xdmf"])
def test_cache_goes_by_the_mesh_in_the_file_and_those_beside_it(tmp_path: Path, suffix: str) -> None:
    path, write = tmp_path / f"a.{suffix}", to_gmsh if suffix == "msh" else to_vtu
    write(small(), path)
    before = snapshot_path(tmp_path, from_file(path), solid(), FEW)
    assert snapshot_path(tmp_path, from_file(path), solid(), FEW) == before
    written, stamp = path.read_bytes(), path.stat().st_mtime_ns
    write(small().scaled(1.01), path)
    if suffix == "xdmf":  # as where the other file alone was written again
        os.utime(path, ns=(stamp, stamp))
    assert (path.read_bytes() == written) == (suffix == "xdmf")  # its numbers lie in another file
    assert snapshot_path(tmp_path, from_file(path), solid(), FEW) != before


def test_cache_knows_the_same_mesh_in_other_bytes(tmp_path: Path) -> None:
    finger, written = from_file(tmp_path / "a.vtu"), []
    for binary in (True, False):
        raw = meshio.read(to_vtu(small(), tmp_path / "a.vtu"))
        raw.cell_data["colour"] = [np.random.default_rng().random(len(block.data)) for block in raw.cells]
        raw.write(tmp_path / "a.vtu", binary=binary)
        written.append(((tmp_path / "a.vtu").read_bytes(), snapshot_path(tmp_path, finger, solid(), FEW)))
    assert written[0][0] != written[1][0] and written[0][1] == written[1][1]


def test_element_must_suit_the_cells(tmp_path: Path) -> None:
    path = to_gmsh(tetrahedra(small()), tmp_path / "a.msh")
    with pytest.raises(InputError, match="'hex20' is an element for hexahedra, but the mesh has tetrahedra: choose"):
        solid(element="hex20").simulate(from_file(path), FEW)
    with pytest.raises(InputError, match="'tet10' is an element for tetrahedra, but the mesh has hexahedra: choose"):
        solid(element="tet10").simulate(pneunet(), FEW)


def without(name: str) -> Mesh:
    mesh = small()
    return replace(mesh, _boundaries={key: facets for key, facets in mesh.boundaries.items() if key != name})


def renamed(mesh: Mesh, **named: Any) -> Mesh:
    return replace(mesh, _boundaries={**mesh.boundaries, **named})


def inverted() -> meshio.Mesh:
    raw = as_meshio(small())
    raw.cells[0].data[3] = raw.cells[0].data[3][[4, 5, 6, 7, 0, 1, 2, 3]]
    return raw


def apart() -> Mesh:
    """The tip cut off and moved away."""
    mesh = small()
    left = mesh.restrict(np.flatnonzero(mesh.p[0, mesh.t].mean(axis=0) < 14))
    right = mesh.restrict(np.flatnonzero(mesh.p[0, mesh.t].mean(axis=0) > 14)).translated([1.0, 0, 0])
    return MeshHex(np.hstack([left.p, right.p]), np.hstack([left.t, right.t + left.p.shape[1]])).with_boundaries(
        {"clamp": lambda x: x[0] < 1e-6}
    )


def test_files_that_are_no_meshes(tmp_path: Path) -> None:
    ran = tmp_path / "ran"

    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (ran,)

    (tmp_path / "trap.msh").write_bytes(pickle.dumps(Trap()))
    (tmp_path / "text.vtu").write_text("no mesh")
    (tmp_path / "a.docx").write_text("no mesh")
    (tmp_path / "cut.msh").write_bytes(to_gmsh(small(), tmp_path / "a.msh").read_bytes()[:3000])
    for name in ("trap.msh", "text.vtu", "a.docx", "cut.msh"):
        with pytest.raises(InputError, match=f"{name} cannot be read as a mesh"):
            from_file(tmp_path / name).mesh(1.0)
    assert not ran.exists()


@pytest.mark.parametrize("path", ["", "nowhere.msh"])
def test_missing_file_is_noticed_before_anything_is_computed(tmp_path: Path, path: str) -> None:
    finger = replace(from_file(tmp_path), path=path)
    with pytest.raises(InputError, match=f"finger.path is '{path}', and there is no such file"):
        snapshot_path(tmp_path, finger, solid(), FEW)


def test_unknown_unit() -> None:
    with pytest.raises(InputError, match="finger.unit is 'km'; choose one of mm, cm, m"):
        from_file(Path("a.msh"), unit="km")


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (
            lambda: without("clamp"),
            r"has no group 'clamp' of .* for finger.clamp; its groups are cavity \(29 facets\), symmetry \(24 facets\)"
            r"\. Or say where it lies, e\.g\. \"finger.clamp='x<1'\"",
        ),
        (lambda: without("symmetry"), r"is open along \d+ edges, .* plane of symmetry, which needs a group 'symmetry'"),
        (lambda: small().scaled(1e-3), r"is 0\.022 × 0\.008 × 0\.017 mm large, .* finger\.unit=m would make it"),
        (lambda: small().scaled(1e5), r"which is no finger: check the file and finger\.unit"),
        (inverted, r"1 of 57 elements of .* are inverted against the rest or flat, the first near \(.*\) mm"),
        (apart, r"form 2 pieces that share no facet, the smallest near \(.*\) mm"),
        (lambda: renamed(small(), cavity=small().boundaries["cavity"][3:]), r"is open along \d+ edges, the first near"),
        (
            lambda: renamed(small(), clamp=small().boundaries["cavity"]),
            r"29 facets of .* are in both the groups for finger.cavity and finger.clamp",
        ),
        (
            lambda: renamed(small(), clamp=np.setdiff1d(np.arange(200), small().boundary_facets())[:2]),
            "not on the surf",
        ),
        (lambda: renamed(small(), symmetry=small().facets_satisfying(lambda x: x[1] > 7.9)), "plane of smallest y"),
        (lambda: meshio.Mesh(np.eye(3) * 50, [("triangle", [[0, 1, 2]])]), "has no volume elements, only surfaces"),
        (
            lambda: meshio.Mesh(np.random.default_rng(0).normal(size=(6, 3)), [("wedge", [[0, 1, 2, 3, 4, 5]])]),
            r"has elements of type wedge; a finger is meshed with one of tetra, tetra10, hexahedron",
        ),
    ],
)
def test_what_is_no_finger_is_refused(tmp_path: Path, make: Callable[[], Any], sentence: str) -> None:
    made = make()
    if isinstance(made, Mesh):
        path = to_gmsh(made, tmp_path / "a.msh")
    else:
        path = tmp_path / "a.vtu"
        made.write(path)
    with pytest.raises(InputError, match=sentence) as refused:
        from_file(path).mesh(1.0)
    assert "\n" not in str(refused.value)


def test_outer_surface_is_no_cavity(tmp_path: Path) -> None:
    mesh = small()
    taken = np.concatenate(list(mesh.boundaries.values()))
    outside = renamed(mesh, cavity=np.setdiff1d(mesh.boundary_facets(), taken))
    with pytest.raises(InputError, match=r"encloses no air around \(.*\) mm: its group must hold the inner walls"):
        from_file(to_gmsh(outside, tmp_path / "a.msh")).mesh(1.0)


def test_shipped_example() -> None:
    path = CHECKOUT / "examples" / "finger.msh"
    assert path.stat().st_size < 2e6
    mesh = from_file(path).mesh(1.0)
    assert isinstance(mesh, MeshTet)
    assert set(mesh.boundaries) == {"clamp", "symmetry", "cavity"}
    assert len(from_file(path).face(1000).domain.points_mm) == 1000
