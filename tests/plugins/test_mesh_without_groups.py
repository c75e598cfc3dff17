"""From a mesh that names nothing to a finger: its chambers found, its clamp said by place, a surface file beside it."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.meshaxes import rotation, within
from pgdl_lab.mechanics.meshsurface import distances
from pgdl_lab.running.cache import snapshot_path
from tests.conftest import composed
from tests.fingers import from_file, solid
from tests.meshes import Array, Index, bricks, chamber, groups, inside, save, skin, tetrahedra

registry.discover()


def bare(path: Path, points: Array, cells: Index) -> Path:
    """Elements alone, as SOFA's meshes are."""
    meshio.write_points_cells(path, points, [("hexahedron" if cells.shape[1] == 8 else "tetra", cells)])
    return path


def stl(path: Path, points: Array, quads: Index) -> Path:
    meshio.write_points_cells(path, points, [("triangle", np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))])
    return path


def same(one: Finger, other: Finger) -> None:
    """Check that two fingers have one mesh and the same parts of it."""
    mesh, asked = one.mesh(1.0), other.mesh(1.0)
    np.testing.assert_allclose(mesh.p, asked.p, atol=1e-9)
    np.testing.assert_array_equal(mesh.t, asked.t)
    for name, facets in asked.boundaries.items():
        np.testing.assert_array_equal(np.sort(mesh.boundaries[name]), np.sort(facets))


@pytest.mark.parametrize("split", [False, True], ids=["hexahedra", "tetrahedra"])
def test_bare_mesh_in_other_axes_is_the_finger_with_groups(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, split: bool
) -> None:
    points, cells = bricks()
    cells = tetrahedra(cells) if split else cells
    axes = ["-x", "-z", "-y"]
    turned = (points + [3, 4, 5]) @ rotation(axes)  # the other way round
    found = from_file(bare(tmp_path / "bare.vtu", turned, cells), axes=axes, clamp="x<1")
    with caplog.at_level("INFO", "pgdl_lab"):
        same(found, from_file(save(tmp_path / "named.vtu", points, cells)))
    assert "bare.vtu names no cavity: the air presses on its 1 closed inner surface, 720 mm³ around (" in caplog.text
    assert "named.vtu names no" not in caplog.text


def test_what_is_typed_reaches_the_finger(tmp_path: Path) -> None:
    typed = composed("finger=mesh", "finger.path=a.vtk", "finger.axes=[-x,-z,-y]", "finger.clamp='x<1'").finger
    assert list(typed.axes) == ["-x", "-z", "-y"] and typed.clamp == "x<1"


def test_gravity_is_along_the_axes_of_the_lab(tmp_path: Path) -> None:
    points, cells = bricks()
    axes = ["-x", "-z", "-y"]
    fields = {"gravity_m_s2": [0.0, -50.0], "max_kpa": 0.1}
    straight = from_file(save(tmp_path / "a.vtu", points, cells), **fields)
    turned = from_file(bare(tmp_path / "b.vtu", points @ rotation(axes), cells), axes=axes, clamp="x<1", **fields)
    one, other = (solid(interpolation_mm=1e-2).simulate(finger, Observation(1, 200)) for finger in (straight, turned))
    assert one.displacements[-1, :, 1].min() < -0.1
    np.testing.assert_allclose(other.displacements, one.displacements, atol=1e-9)


def test_several_chambers_get_air(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    points, cells = bricks(lambda i, j, k: chamber(i, j, k) and i != 3)
    with caplog.at_level("INFO", "pgdl_lab"):
        mesh = from_file(bare(tmp_path / "a.vtu", points, cells), clamp="x<1").mesh(1.0)
    assert "its 2 closed inner surfaces, 360 mm³ around (27.5, 0, 7) mm and 240 mm³ around (10, 0, 7) mm" in caplog.text
    middles = points[skin(cells)].mean(axis=1)
    assert len(mesh.boundaries["cavity"]) == inside(middles).sum()


def test_chamber_that_the_plane_and_the_clamp_close_is_found(tmp_path: Path) -> None:
    points, cells = bricks(lambda i, j, k: i <= 6 and j == 0 and k == 1, ys=(0.0, 3.0, 6.0))
    mesh = from_file(bare(tmp_path / "a.vtu", points, cells), clamp="x<1", symmetry="y<1").mesh(1.0)
    facets = skin(cells)
    flat = np.ptp(points[facets], axis=1) < 1e-9
    middles = points[facets].mean(axis=1)
    walls = inside(middles, (0, 0, 5), (35, 3, 9)) & ~((middles[:, 1] < 0.1) & flat[:, 1])
    assert len(mesh.boundaries["cavity"]) == walls.sum()


@pytest.mark.parametrize("open_to", [chamber, lambda i, j, k: i == 2 and k == 1])
def test_body_without_a_closed_chamber_is_refused(tmp_path: Path, open_to: Any) -> None:
    """Solid, or with a hole from side to side."""
    hole = (lambda i, j, k: False) if open_to is chamber else open_to
    with pytest.raises(InputError, match=r"no group 'cavity' .* no closed inner surface .*; its groups are none\."):
        from_file(bare(tmp_path / "a.vtu", *bricks(hole)), clamp="x<1").mesh(1.0)


def test_named_cavity_that_is_not_there_is_not_guessed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no group 'air' of facets or nodes for finger.cavity"):
        from_file(bare(tmp_path / "a.vtu", *bricks()), clamp="x<1", cavity="air").mesh(1.0)


def test_clamp_is_not_guessed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"its groups are none\. Or say where it lies, e\.g\. \"finger\.clamp='x<1'\""):
        from_file(bare(tmp_path / "a.vtu", *bricks())).mesh(1.0)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("x<1", 9),
        ("x < 1", 9),
        ("x<=0", 9),
        ("x<0", 0),
        ("x<=5", 9 + 12),
        ("x<=5 and z>=5", 6 + 7),
        ("x<1 and y>-1", 3),
        ("x<1 and z>5", 3),
        ("z<1e0 and x<=1.0e+1", 6),
    ],
)
def test_places_of_a_clamp(tmp_path: Path, text: str, count: int) -> None:
    finger = from_file(bare(tmp_path / "a.vtu", *bricks()), clamp=text)
    if count:
        assert len(finger.mesh(1.0).boundaries["clamp"]) == count
    else:
        with pytest.raises(InputError, match=r"x<0 holds no whole facet of the surface for finger\.clamp"):
            finger.mesh(1.0)


@pytest.mark.parametrize(
    "text", ["x<", "<1", "1<x", "w<1", "x<1 or y<2", "x<1,y<2", "x<1 and", "x<a", "x<<1", "x<1; import os", "x==1<2"]
)
def test_what_says_no_place_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="says no place: write x, y or z, then <, <=, > or >=, then a number"):
        within(text, np.zeros((2, 3)), "finger.clamp")


def test_limit_is_met_to_round_off() -> None:
    points = np.zeros((4, 3))
    points[:, 0] = [0, 5 - 1e-9, 5 + 1e-9, 40]
    for text, inside_ in (("x<5", [1, 0, 0, 0]), ("x<=5", [1, 1, 1, 0]), ("x>5", [0, 0, 0, 1]), ("x>=5", [0, 1, 1, 1])):
        np.testing.assert_array_equal(within(text, points, "finger.clamp"), inside_)


def test_clamp_by_place_holds_from_outside(tmp_path: Path) -> None:
    """The end wall of the chamber lies in the place, too, and still gets air."""
    points, cells = bricks()
    mesh = from_file(bare(tmp_path / "a.vtu", points, cells), clamp="x<=10").mesh(1.0)
    assert len(mesh.boundaries["cavity"]) == groups(points, skin(cells))["cavity"].sum()


def test_place_is_measured_from_the_end_and_the_middle(tmp_path: Path) -> None:
    """In other units and elsewhere, where coordinates are rounded."""
    points, cells = bricks()
    path = bare(tmp_path / "a.vtu", (points + [100.1, 50.7, -30.3]) * 1e-3, cells)
    for text, count in (("x<1 and y>-4 and y<4", 3), ("x<=5 and y>=-3 and y<=3", 3 + 2), ("x<5", 9)):
        assert len(from_file(path, clamp=text, unit="m").mesh(1.0).boundaries["clamp"]) == count


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_surface_file_picks_the_walls_that_lie_on_it(tmp_path: Path, unit: str) -> None:
    """The surface is meshed on its own, twice as coarse; of two chambers it is that of one."""
    points, cells = bricks(lambda i, j, k: chamber(i, j, k) and i != 3)
    box, brick = bricks(lambda i, j, k: False, xs=(20.0, 35.0), ys=(-3.0, 3.0), zs=(5.0, 9.0))
    axes, scale = ["-x", "-z", "-y"], {"mm": 1.0, "m": 1e-3}[unit]
    fields = {"axes": axes, "clamp": "x<1", "unit": unit}
    surface = stl(tmp_path / "a.stl", box @ rotation(axes) * scale, skin(brick))
    path = bare(tmp_path / "a.vtu", points @ rotation(axes) * scale, cells)
    finger = from_file(path, cavity=str(surface), **fields)
    walls = inside(points[skin(cells)].mean(axis=1), (20, -3, 5), (35, 3, 9))
    assert len(finger.mesh(1.0).boundaries["cavity"]) == walls.sum()
    (told,) = finger.doubts()
    assert "1 more closed inner surface in no group of finger.cavity, 240 mm³" in told


def test_surface_file_that_lies_elsewhere_is_refused(tmp_path: Path) -> None:
    box, brick = bricks(lambda i, j, k: False, xs=(5.0, 35.0), ys=(-3.0, 3.0), zs=(5.0, 9.0))
    path = bare(tmp_path / "a.vtu", *bricks())
    elsewhere = stl(tmp_path / "a.stl", box * 1e-3 + [0, 0, 20], skin(brick))
    with pytest.raises(
        InputError,
        match=r"No facet of .* lies within 0\.\d+ mm of .* \(the surface spans 0\.005…0\.035 × .* the body 0…40 ×",
    ):
        from_file(path, clamp="x<1", cavity=str(elsewhere)).mesh(1.0)
    with pytest.raises(InputError, match="finger.cavity is 'b.stl', and there is no such file"):
        from_file(path, clamp="x<1", cavity="b.stl").mesh(1.0)
    part = stl(tmp_path / "c.stl", box, skin(brick)[:4])
    with pytest.raises(InputError, match="is open along"):
        from_file(path, clamp="x<1", cavity=str(part)).mesh(1.0)


def test_distance_from_triangles_against_many_points_on_them() -> None:
    rng = np.random.default_rng(0)
    surface = rng.normal(size=(5, 3, 3))
    points = rng.normal(size=(200, 3))
    share = rng.dirichlet(np.ones(3), size=4000)
    dense = np.concatenate(
        [np.einsum("sc,tcx->tsx", share, surface).reshape(-1, 3)]
        + [np.linspace(surface[:, i], surface[:, i - 1], 400).reshape(-1, 3) for i in range(3)]
    )
    nearest = np.array([np.linalg.norm(dense - point, axis=1).min() for point in points])
    found = distances(points, surface, 1.0)
    np.testing.assert_allclose(found[nearest < 0.9], nearest[nearest < 0.9], atol=0.05)
    assert (found <= nearest + 1e-12)[nearest <= 1].all() and np.isinf(found[nearest > 1.06]).all()
    flat = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    np.testing.assert_allclose(distances(np.array([[1.5, 0.25, 0.0]]), flat, 1.0), 0.25)


def test_what_a_surface_file_selects_counts_for_what_is_kept(tmp_path: Path) -> None:
    path = bare(tmp_path / "a.vtu", *bricks(lambda i, j, k: chamber(i, j, k) and i != 3))
    surface = tmp_path / "a.stl"
    finger = from_file(path, clamp="x<1", cavity=str(surface))

    def key(xs: tuple[float, ...], by: float = 1.0) -> Path:
        box, brick = bricks(lambda i, j, k: False, xs=xs, ys=(-3.0, 3.0), zs=(5.0, 9.0))
        stl(surface, box * by, skin(brick))
        return snapshot_path(tmp_path, finger, solid(), Observation(1, 200))

    root = key((5.0, 15.0))
    assert key((20.0, 35.0)) != root
    assert key((5.0, 15.0), by=1.001) == root  # the same facets


def test_changed_file_is_read_again(tmp_path: Path) -> None:
    points, cells = bricks()
    finger = from_file(save(tmp_path / "a.vtu", points, cells))
    before = finger.mesh(1.0)
    assert finger.mesh(1.0) is before
    save(tmp_path / "a.vtu", points * 1.25, cells, groups(points, skin(cells)))
    assert finger.mesh(1.0).p.max() == pytest.approx(50)
