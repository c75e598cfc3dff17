"""Pictures of a finger for a notebook: the bent side face, coloured by how far its points move."""

from __future__ import annotations

import base64
import html
import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.deploy.face_mesh import FaceMesh
from pgdl_lab.errors import InputError
from pgdl_lab.snapshots import Snapshots
from pgdl_lab.surrogate import Face, Surrogate

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot(shown: Snapshots | Surrogate, pressure_kpa: float, axes: Axes | None = None) -> Axes:
    """Draw the bent side face at a pressure, over its shape at rest.

    Parameters
    ----------
    shown
        A surrogate, or snapshots, of which the nearest to the pressure is drawn.
    pressure_kpa
        The pressure [kPa].
    axes
        Where to draw, by default in a new figure of pyplot.

    Raises
    ------
    InputError
        When the pressure lies outside what is known.

    Examples
    --------
    >>> import pgdl_lab as lab
    >>> finger = lab.Pneunet(chambers=2, max_kpa=10.0)
    >>> data = lab.simulate(finger, lab.Rod(), observation=lab.Observation(snapshots=10, points=200))
    >>> lab.plot(data, 10.0).get_title()
    'pneunet at 10 kPa'
    """
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(figsize=(7, 3.5), layout="constrained")[1]
    face, moved, kpa = _state(shown, pressure_kpa)
    rest, triangles = face.mesh.points_mm, face.mesh.triangles
    x, z = (rest + moved).T
    axes.triplot(rest[:, 0], rest[:, 1], triangles, color="0.88", linewidth=0.4, zorder=0)
    size = np.linalg.norm(moved, axis=1)
    bent = axes.tripcolor(x, z, size, triangles=triangles, shading="gouraud")
    axes.plot(x[face.base], z[face.base], color="white", linewidth=1.2)
    axes.figure.colorbar(bent, ax=axes, label="displacement [mm]")
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", title=f"{_name(shown)} at {kpa:g} kPa")
    return axes


def shown(snapshots: Snapshots) -> str:
    """HTML of a sentence about `snapshots` and a picture of them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3.5), layout="constrained")
    plot(snapshots, float(snapshots.pressures_kpa[-1]), figure.subplots())
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    sentences = [repr(snapshots)[1:-1], *snapshots.warnings]
    told = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in sentences)
    return (
        f'{told}<img alt="the bent side face" src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'
    )


def _state(shown: Snapshots | Surrogate, kpa: float) -> tuple[Face, NDArray[np.float64], float]:
    """The face, the displacements (N, 2) of its points [mm] and the pressure that they are at [kPa]."""
    if not isinstance(shown, Snapshots):
        return shown.face, shown.predict(shown.face.mesh.points_mm, float(kpa)), float(kpa)
    known = shown.pressures_kpa
    if not 0 <= kpa <= known[-1]:
        raise InputError(f"pressure_kpa is {kpa:g}; these snapshots go from {known[0]:g} to {known[-1]:g} kPa.")
    nearest = int(np.abs(known - kpa).argmin())
    face = Face(FaceMesh(shown.points, shown.triangles), shown.base)
    return face, shown.displacements[nearest], float(known[nearest])


def _name(shown: Snapshots | Surrogate) -> Any:
    provenance = shown.provenance if isinstance(shown, Snapshots) else shown.record.provenance
    return provenance.get("finger", {}).get("name", "finger")
