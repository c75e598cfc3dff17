"""Whether a user's mesh lies as the lab has fingers lie: x from the clamp to the tip, z up, the same on both sides."""

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.meshaxes import named
from pgdl_lab.mechanics.meshcavity import outward

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]

FREE = 0.1  # of the length: the clamp begins in the first, and leaves free the last such part
LOPSIDED = 0.01  # of the largest side: the two sides of a body may differ by that much
IN_PLANE = 1e-6  # of the largest side
SYMMETRY = re.compile("sym|mirror", re.IGNORECASE)
ONE_SIDED = 4.0  # times as uneven across as along z is a body that lies on its side
UNITS = np.eye(3)


def require_laid(mesh: "Mesh", path: str, axes: Array) -> None:
    """Check that the clamp is at the least x and the tip, at the greatest x, is free.

    Parameters
    ----------
    axes
        (3, 3) the axes of the lab in terms of the file's.

    Raises
    ------
    InputError
        Otherwise.
    """
    clamp = mesh.boundaries["clamp"]
    x, held = mesh.p[0], mesh.p[0, mesh.facets[:, clamp]]
    length = float(np.ptp(x))
    first, last = float(held.min()), float(held.max())
    if first - x.min() <= FREE * length and last <= x.max() - FREE * length:
        return
    where = f"x = {first:.4g}" if np.ptp(held) < 1e-3 * length else f"x = {first:.4g} to {last:.4g}"
    raise InputError(
        f"The body of {path} lies at x = {x.min():.4g} to {x.max():.4g} mm and its clamp at {where}: x must run from "
        f"the clamp to a free tip{_turn(mesh, axes)}."
    )


def _turn(mesh: "Mesh", axes: Array) -> str:
    """What to type so that x runs from the clamp into the body; nothing if it does, or if the clamp faces nowhere."""
    clamp = mesh.boundaries["clamp"]
    corners = mesh.p[:, mesh.facets[:, clamp]].transpose(2, 1, 0)
    area = outward(corners, mesh.p[:, mesh.t[:, mesh.f2t[0, clamp]]].mean(axis=1).T)
    into = -area.sum(axis=0)
    axis = int(np.abs(into).argmax())
    if abs(into[axis]) < np.linalg.norm(area, axis=1).sum() / 2 or (axis == 0 and into[0] > 0):
        return ""
    sign = 1.0 if into[axis] > 0 else -1.0
    if axis == 0:  # half a turn; half a finger keeps to its side of y = 0
        turn = np.diag([-1.0, 1.0 if "symmetry" in mesh.boundaries else -1.0, 1.0])
    else:  # a quarter turn in the plane of x and that axis
        turn = UNITS.copy()
        turn[0], turn[axis] = sign * UNITS[axis], -sign * UNITS[0]
    return f", so try finger.axes={named(turn @ axes)}"


def require_plane(mesh: "Mesh", path: str, axes: Array) -> None:
    """Check that the plane of symmetry is the one of the least y.

    Raises
    ------
    InputError
        Otherwise.
    """
    nodes = mesh.p[:, mesh.facets[:, mesh.boundaries["symmetry"]]].reshape(3, -1)
    low, high = mesh.p.min(axis=1), mesh.p.max(axis=1)
    near = IN_PLANE * float((high - low).max())
    if np.ptp(nodes[1]) <= near and nodes[1].max() <= low[1] + near:
        return
    hint = ""
    for axis in (1, 2):
        at_least, at_most = nodes[axis].max() <= low[axis] + near, nodes[axis].min() >= high[axis] - near
        if at_least or at_most:  # half a finger may be mirrored: its whole stays the same
            turn = np.diag([1.0, 1.0 if at_least else -1.0, 1.0]) @ UNITS[[0, axis, 3 - axis]]
            hint = f", so try finger.axes={named(turn @ axes)}"
    raise InputError(
        f"The symmetry group of {path} spans y = {nodes[1].min():.4g} to {nodes[1].max():.4g} mm and the body "
        f"{low[1]:.4g} to {high[1]:.4g} mm: it must be the plane of smallest y{hint}."
    )


def require_turned(path: str, axes: Array) -> None:
    """Check that a whole finger is turned, not mirrored; the whole of a mirrored half is the same finger, turned.

    Raises
    ------
    InputError
        Otherwise.
    """
    if np.linalg.det(axes) < 0:
        raise InputError(
            f"finger.axes={named(axes)} makes a mirror image of {path}: turn it instead, e.g. by "
            f"finger.axes={named(np.diag([1.0, -1.0, 1.0]) @ axes)}."
        )


def sides(mesh: "Mesh", path: str, axes: Array, plane: str | None, surely: bool) -> str | None:
    """What is odd about a whole finger that is not the same on both sides of y = 0; None if nothing is.

    The sides are told apart by the moments of their mass, which depend little on how each is meshed.

    Parameters
    ----------
    axes
        (3, 3) the axes of the lab in terms of the file's.
    plane
        Name of a group in the plane of least y, which may be one of symmetry.
    surely
        Whether the user says that the file holds a whole finger.

    Raises
    ------
    InputError
        Unless `surely`: when there is such a `plane`, or when the body is the same on both sides of the middle of z
        instead, so that it lies on its side.
    """
    corners = mesh.p[:, mesh.t]
    centre = corners.mean(axis=1) - (mesh.p.max(axis=1) + mesh.p.min(axis=1))[:, None] / 2
    across, up = (_unevenness(centre, _volumes(corners), axis) for axis in (1, 2))
    half = f"its group '{plane}' lies in the plane of least y: type finger.symmetry={plane}"
    whole = "or finger.symmetry=none if the file has the whole finger, as it is meant to be"
    if across < LOPSIDED:
        if plane is not None and SYMMETRY.search(plane):
            raise InputError(f"In {path} {half}, {whole}.")
        return None
    told = f"The two sides of {path} across y differ (in the moments of their mass by {across:.1%} of the width)"
    if surely:
        return f"{told}: motion along y is not observed."
    if plane is not None:
        raise InputError(f"{told}, and {half}, {whole}.")
    if up < across / ONE_SIDED:
        turn = np.array([UNITS[0], -UNITS[2], UNITS[1]])
        raise InputError(
            f"{told}, those of z do not, so it lies on its side: try finger.axes={named(turn @ axes)}, name the plane "
            f"of symmetry of half a finger (finger.symmetry), {whole}."
        )
    return f"{told}: motion along y is not observed, and half a finger needs its plane of symmetry, finger.symmetry."


def _unevenness(centre: Array, volume: Array, axis: int) -> float:
    """How far the mass is from the same on both sides of the middle along an axis, as a part of the width there [–].

    `centre` (3, E) are middles of elements from the middle of the body [mm], `volume` (E,) their volumes [mm³]. The
    largest of the first moment and of the two products of inertia: unlike halves may balance along x.
    """
    half = np.abs(centre).max(axis=1, keepdims=True)
    place = centre / half
    along = [np.ones(len(volume)), *(place[other] for other in range(3) if other != axis)]
    return float(max(abs((volume * place[axis] * weight).sum()) for weight in along) / volume.sum() / 2)


def _volumes(corners: Array) -> Array:
    """Volumes (E,) of elements with `corners` (3, 4 or 8, E) in the order of scikit-fem [mm³]."""
    rows = [[0, 1, 2, 3]] if corners.shape[1] == 4 else [[0, 1, 2, 4], [7, 6, 5, 4]]
    edges = [corners[:, row[1:]] - corners[:, row[:1]] for row in rows]
    dets = [np.abs(np.linalg.det(edge.transpose(2, 1, 0))) for edge in edges]
    return dets[0] / 6 if len(dets) == 1 else (dets[0] + dets[1]) / 2
