"""How a mesh file lies: what the lab asks of it is checked before anything is computed, and `finger.axes` turns it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skfem import Mesh

from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.meshaxes import rotation
from pgdl_lab.mechanics.side import find, observe_side
from tests.fingers import OBSERVATION, from_file, solid
from tests.meshes import Array, Index, bricks, groups, inside, save, skin, tetrahedra

registry.discover()

HALF = (0.0, 3.0, 6.0)
WIDE = (-10.0, -6.0, -3.0, 3.0, 6.0, 10.0)


def half(hole: Callable[[int, int, int], bool] = lambda i, j, k: 1 <= i <= 6 and j == 0 and k == 1) -> Any:
    """Points, cells and groups of the half y ≥ 0 of the body, its plane in the group `plane`."""
    points, cells = bricks(hole, ys=HALF)
    facets = skin(cells)
    middles, flat = points[facets].mean(axis=1), np.ptp(points[facets], axis=1) < 1e-9
    plane = (middles[:, 1] < 1e-9) & flat[:, 1]
    cavity = inside(middles) & ~plane
    return points, cells, {"clamp": (middles[:, 0] < 1e-9) & flat[:, 0], "plane": plane, "cavity": cavity}


def flanged() -> tuple[Array, Index]:
    """The body with a root that is wider than the rest."""
    return bricks(lambda i, j, k: (i >= 1 and j in (0, 4)) or (1 <= i <= 6 and j == 2 and k == 1), ys=WIDE)


@dataclass(frozen=True)
class Lie:
    """A body that lies otherwise, what is said of it, and axes under which it is as the body of `bricks`."""

    turn: str
    sentence: str
    axes: str


LIES = {
    "backwards": Lie(
        "[-x,-y,z]",
        r"The body of .* lies at x = -40 to 0 mm and its clamp at x = 0: x must run from the clamp to a free tip, so "
        r"try finger\.axes=\[-x,-y,z\]\.",
        "[-x,-y,z]",
    ),
    "upright": Lie("[-z,y,x]", r"its clamp at x = -12 to 0: .* so try finger\.axes=\[z,y,-x\]", "[z,y,-x]"),
    "hanging": Lie("[z,y,-x]", r"its clamp at x = 0 to 12: .* so try finger\.axes=\[-z,y,x\]", "[-z,y,x]"),
    "across": Lie("[-y,x,z]", r"its clamp at x = -6 to 6: .* so try finger\.axes=\[y,-x,z\]", "[y,-x,z]"),
    "y up": Lie(
        "[x,z,-y]",
        r"The two sides of .* across y differ \(in the moments of their mass by 1\.6% of the width\), those of z do "
        r"not, so it lies on its side: try finger\.axes=\[x,-z,y\], .* or finger\.symmetry=none",
        "[x,-z,y]",
    ),
}


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
def test_body_that_lies_otherwise_is_refused_with_axes_that_work(tmp_path: Path, lie: Lie) -> None:
    points, cells = bricks()
    facets = skin(cells)
    path = save(tmp_path / "a.vtu", points @ rotation(lie.turn[1:-1].split(",")).T, cells, groups(points, facets))
    with pytest.raises(InputError, match=lie.sentence):
        from_file(path).mesh(1.0)
    turned = from_file(path, axes=lie.axes[1:-1].split(",")).mesh(1.0)
    straight = from_file(save(tmp_path / "b.vtu", points, cells)).mesh(1.0)
    assert turned.t.shape == straight.t.shape
    np.testing.assert_allclose(turned.p, straight.p, atol=1e-9)
    for name in straight.boundaries:
        np.testing.assert_array_equal(turned.boundaries[name], straight.boundaries[name])


@pytest.mark.parametrize("axes", [["x", "y"], ["x", "x", "z"], ["x", "y", "w"], ["x", "y", "z", "z"], ["x", "y", ""]])
def test_axes_are_each_axis_once(axes: list[str]) -> None:
    with pytest.raises(InputError, match=r"finger\.axes is \[.*\]; give the file's axes that become x"):
        from_file(Path("a.vtu"), axes=axes)


def test_mirror_image_of_a_whole_finger_is_refused(tmp_path: Path) -> None:
    points, cells = bricks()
    path = save(tmp_path / "a.vtu", points, cells)
    with pytest.raises(
        InputError, match=r"finger\.axes=\[x,-y,z\] makes a mirror image of .*: turn it .* finger\.axes=\[x,y,z\]"
    ):
        from_file(path, axes=["x", "-y", "z"]).mesh(1.0)


@pytest.mark.parametrize("split", [False, True], ids=["hexahedra", "tetrahedra"])
def test_mirrored_half_is_the_half_on_the_other_side(tmp_path: Path, split: bool) -> None:
    points, cells, named = half()
    if split:
        cells = tetrahedra(cells)
        middles = points[skin(cells)].mean(axis=1)
        flat = np.ptp(points[skin(cells)], axis=1) < 1e-9
        plane = (middles[:, 1] < 1e-9) & flat[:, 1]
        named = {"clamp": (middles[:, 0] < 1e-9) & flat[:, 0], "plane": plane, "cavity": inside(middles) & ~plane}
    straight = from_file(save(tmp_path / "a.vtu", points, cells, named), symmetry="plane").mesh(1.0)
    path = save(
        tmp_path / "b.vtu", points * [1, -1, 1], cells[:, [1, 0, 2, 3] if split else [*range(4, 8), *range(4)]], named
    )
    with pytest.raises(InputError, match=r"must be the plane of smallest y, so try finger\.axes=\[x,-y,z\]"):
        from_file(path, symmetry="plane").mesh(1.0)
    mirrored = from_file(path, symmetry="plane", axes=["x", "-y", "z"]).mesh(1.0)
    np.testing.assert_allclose(mirrored.p, straight.p, atol=1e-9)
    assert (_hands(mirrored) == _hands(straight)).all()


def _hands(mesh: Mesh) -> Any:
    """Signs of the volumes at one corner of all elements."""
    corners = mesh.p[:, mesh.t[:4]]
    return np.sign(np.linalg.det((corners[:, 1:] - corners[:, :1]).transpose(2, 1, 0)))


def test_plane_of_symmetry_below_is_turned_to_the_side(tmp_path: Path) -> None:
    points, cells, named = half()
    path = save(tmp_path / "a.vtu", points @ rotation(["x", "-z", "y"]).T, cells, named)
    with pytest.raises(InputError, match=r"must be the plane of smallest y, so try finger\.axes=\[x,z,y\]"):
        from_file(path, symmetry="plane").mesh(1.0)
    assert from_file(path, symmetry="plane", axes=["x", "z", "y"]).mesh(1.0).p.max() == 40


def test_clamp_that_holds_the_tip_is_refused(tmp_path: Path) -> None:
    points, cells = bricks()
    middles = points[skin(cells)].mean(axis=1)
    both = {**groups(points, skin(cells)), "clamp": (middles[:, 0] < 1e-9) | (middles[:, 0] > 40 - 1e-9)}
    with pytest.raises(InputError, match=r"its clamp at x = 0 to 40: x must run from the clamp to a free tip\."):
        from_file(save(tmp_path / "a.vtu", points, cells, both)).mesh(1.0)


def test_clamp_in_the_middle_is_refused(tmp_path: Path) -> None:
    points, cells = bricks()
    middles = points[skin(cells)].mean(axis=1)
    ring = {**groups(points, skin(cells)), "clamp": (np.abs(middles[:, 0] - 17.5) < 1) & ~inside(middles)}
    with pytest.raises(InputError, match=r"lies at x = 0 to 40 mm and its clamp at x = 15 to 20: x must run from the"):
        from_file(save(tmp_path / "a.vtu", points, cells, ring)).mesh(1.0)


@pytest.mark.parametrize("typed", ["Plane", "mirror", "symmetri"])
def test_name_of_a_plane_that_is_not_there_is_refused(tmp_path: Path, typed: str) -> None:
    points, cells, named = half()
    path = save(tmp_path / "a.vtu", points, cells, named)
    with pytest.raises(InputError, match=rf"has no group '{typed}' .* finger\.symmetry; its groups are .*plane \("):
        from_file(path, symmetry=typed).mesh(1.0)
    if typed == "Plane":
        with pytest.raises(InputError, match="Did you mean 'plane'?"):
            from_file(path, symmetry=typed).mesh(1.0)


def closed_half() -> Any:
    """The half of a finger of two chambers side by side, each closed: nothing is open without its plane."""
    points, cells = bricks(lambda i, j, k: 1 <= i <= 6 and j == 1 and k == 1, ys=(0.0, 2.0, 5.0, 6.0))
    middles = points[skin(cells)].mean(axis=1)
    flat = np.ptp(points[skin(cells)], axis=1) < 1e-9
    cavity = inside(middles, (5, 2, 5), (35, 5, 9))
    return (
        points,
        cells,
        {
            "clamp": (middles[:, 0] < 1e-9) & flat[:, 0],
            "cavity": cavity,
            "inner side": (middles[:, 1] < 1e-9) & flat[:, 1],
        },
    )


def test_half_that_nobody_calls_one_is_asked_about(tmp_path: Path) -> None:
    points, cells, named = closed_half()
    path = save(tmp_path / "a.vtu", points, cells, named)
    with pytest.raises(
        InputError,
        match=r"two sides of .* its group 'inner side' lies in the plane of least y: type finger\.symmetry=inner",
    ):
        from_file(path).mesh(1.0)
    assert "symmetry" in from_file(path, symmetry="inner side").mesh(1.0).boundaries
    whole = from_file(path, symmetry="none")
    assert "symmetry" not in whole.mesh(1.0).boundaries
    assert any("The two sides of" in doubt for doubt in whole.doubts())


def test_even_half_with_a_plane_called_so_is_asked_about(tmp_path: Path) -> None:
    points, cells = bricks()  # stands for the half of a finger twice as wide
    middles = points[skin(cells)].mean(axis=1)
    named = {**groups(points, skin(cells)), "Mirror": middles[:, 1] < -6 + 1e-9}
    with pytest.raises(InputError, match=r"In .* its group 'Mirror' lies in the plane of least y: .*symmetry=Mirror"):
        from_file(save(tmp_path / "a.vtu", points, cells, named)).mesh(1.0)
    del named["Mirror"]
    assert not from_file(save(tmp_path / "b.vtu", points, cells, named)).doubts()


def test_place_of_the_plane_may_be_said(tmp_path: Path) -> None:
    points, cells, named = half()
    path = save(tmp_path / "a.vtu", points + [0, 17, 0], cells, {"cavity": named["cavity"]})
    mesh = from_file(path, symmetry="y<1", clamp="x<1").mesh(1.0)
    assert {name: len(facets) for name, facets in mesh.boundaries.items()} == {
        name: int(named[group].sum())
        for name, group in (("symmetry", "plane"), ("clamp", "clamp"), ("cavity", "cavity"))
    }


def test_lopsided_finger_is_told(tmp_path: Path) -> None:
    points, cells = bricks(lambda i, j, k: 1 <= i <= 6 and j == 1 and k == 1, ys=(-6.0, -1.0, 5.0, 6.0))
    named = {**groups(points, skin(cells)), "cavity": inside(points[skin(cells)].mean(axis=1), (5, -1, 5), (35, 5, 9))}
    (told,) = from_file(save(tmp_path / "a.vtu", points, cells, named)).doubts()
    assert told.startswith("The two sides of") and "half a finger needs its plane of symmetry" in told


def test_chambers_on_alternate_sides_are_told(tmp_path: Path) -> None:
    """The halves have the same mass, but not at the same places."""
    points, cells = bricks(
        lambda i, j, k: k == 1 and ((j == 1 and 1 <= i <= 3) or (j == 2 and 4 <= i <= 6)),
        ys=(-6.0, -5.5, 0.0, 5.5, 6.0),
        zs=(0.0, 1.0, 11.0, 12.0),
    )
    middles = points[skin(cells)].mean(axis=1)
    near, far = inside(middles, (5, -5.5, 1), (20, 0, 11)), inside(middles, (20, 0, 1), (35, 5.5, 11))
    path = save(tmp_path / "a.vtu", points, cells, {**groups(points, skin(cells)), "cavity": near | far})
    with pytest.raises(InputError, match=r"The two sides of .* across y differ"):
        from_file(path).mesh(1.0)


def test_wide_root_is_not_taken_for_the_side(tmp_path: Path) -> None:
    points, cells = flanged()
    finger = from_file(save(tmp_path / "a.vtu", points, cells))
    face = finger.face(400)
    assert len(face.domain.points_mm) == 400
    base = face.domain.points_mm[face.domain.base]
    np.testing.assert_allclose(base[[0, -1]], [[0, 0], [40, 0]], atol=1e-6)
    assert np.diff(base[:, 0]).max() < 3
    apart = np.abs(face.domain.points_mm[:, 0] - 5) > 1e-6
    y = np.broadcast_to(face.y_mm, len(face.domain.points_mm))
    np.testing.assert_allclose(y[apart], np.where(face.domain.points_mm[apart, 0] < 5, 10, 6), atol=1e-6)
    assert len(np.unique(face.domain.points_mm.round(6), axis=0)) == 400  # of two points at one place one is seen
    np.testing.assert_allclose(face.domain.points_mm[face.domain.clamp, 0], 0, atol=1e-6)
    corners = face.domain.points_mm[face.domain.cells]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2 == pytest.approx(40 * 12)


def test_part_of_the_side_that_another_hides_is_not_observed(tmp_path: Path) -> None:
    """A root that is wider in its upper half, over all of a side that goes on beneath it."""
    points, cells = bricks(
        lambda i, j, k: (j in (0, 4) and not (i <= 1 and k == 2)) or (1 <= i <= 6 and j == 2 and k == 1), ys=WIDE
    )
    mesh = from_file(save(tmp_path / "a.vtu", points, cells)).mesh(1.0)
    face = observe_side(mesh, 500)
    root = (face.domain.points_mm[:, 0] < 10 - 1e-6) & (face.domain.points_mm[:, 1] > 9 + 1e-6)
    y = np.broadcast_to(face.y_mm, len(face.domain.points_mm))
    np.testing.assert_allclose(y[root], 10, atol=1e-6)
    np.testing.assert_allclose(face.domain.points_mm[face.domain.base][[0, -1], 0], [0, 40], atol=1e-6)
    below = face.domain.points_mm[:, 1] < 9 - 1e-6
    np.testing.assert_allclose(y[below], 6, atol=1e-6)


def test_side_behind_a_plate_is_not_observed(tmp_path: Path) -> None:
    """A plate beside the finger, on both sides, that is tied to its root alone."""
    points, cells = bricks(
        lambda i, j, k: (j in (1, 5) and i > 0) or (j in (0, 6) and i > 2) or (j == 3 and k == 1 and 1 <= i <= 6),
        ys=(-10.0, -8.0, -6.0, -3.0, 3.0, 6.0, 8.0, 10.0),
    )
    face = from_file(save(tmp_path / "a.vtu", points, cells)).face(500)
    np.testing.assert_allclose(face.domain.points_mm[face.domain.base][[0, -1], 0], [0, 40], atol=1e-6)
    y = np.broadcast_to(face.y_mm, len(face.domain.points_mm))
    apart = np.abs(face.domain.points_mm[:, 0] - 15) > 1e-6
    np.testing.assert_allclose(y[apart], np.where(face.domain.points_mm[apart, 0] < 15, 10, 6), atol=1e-6)


def test_narrow_joint_between_two_segments_is_observed_too(tmp_path: Path) -> None:
    points, cells = bricks(
        lambda i, j, k: (i == 4 and j in (0, 4)) or (j == 2 and k == 1 and 1 <= i <= 6),
        ys=(-6.0, -4.5, -3.0, 3.0, 4.5, 6.0),
    )
    mesh = from_file(save(tmp_path / "a.vtu", points, cells)).mesh(1.0)
    assert len(np.unique(find(mesh).piece)) == 3
    base = observe_side(mesh, 300).domain.base
    assert np.diff(observe_side(mesh, 300).domain.points_mm[base, 0]).max() < 3


def test_face_that_ends_half_way_is_refused(tmp_path: Path) -> None:
    """Beyond x = 20 the body is a ridge: nothing looks to the side there."""
    points, cells = bricks()
    ridge = points.copy()
    beyond = points[:, 0] > 20 + 1e-9
    ridge[beyond, 1] *= 3 * (1 - points[beyond, 2] / 12.5)
    path = save(tmp_path / "a.vtu", ridge, cells, groups(points, skin(cells)))
    with pytest.raises(InputError, match=r"spans x = 0 to 25 mm, but the body 0 to 40 mm: give the finger a side"):
        from_file(path).face(300)


def test_mistakes_cost_no_simulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pgdl_lab.mechanics import finite_strain

    def refuse(*_: Any) -> None:
        raise AssertionError("something was computed")

    monkeypatch.setattr(finite_strain.Model, "load", refuse)
    points, cells = bricks()
    path = save(tmp_path / "a.vtu", points * [-1, -1, 1], cells, groups(points, skin(cells)))
    with pytest.raises(InputError, match="x must run from the clamp"):
        solid().simulate(from_file(path), replace(OBSERVATION, snapshots=1))
