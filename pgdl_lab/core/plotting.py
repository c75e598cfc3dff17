"""Pictures of a finger for a notebook: the bent side face, coloured by how far its points move."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_face(
    points_mm: NDArray[np.float64], triangles: NDArray[np.int64], base: NDArray[np.int64],
    moved_mm: NDArray[np.float64], title: str, axes: Axes | None = None,
) -> Axes:  # fmt: skip
    """Draw a bent side face over its shape at rest.

    Parameters
    ----------
    points_mm, triangles
        Points (N, 2) at rest [mm] and a triangulation (T, 3) on them.
    base
        (B,), points of the base line.
    moved_mm
        (N, 2), displacements of the points [mm].
    axes
        Where to draw, by default in a new figure of pyplot.
    """
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(figsize=(7, 3.5), layout="constrained")[1]
    x, z = (points_mm + moved_mm).T
    axes.triplot(points_mm[:, 0], points_mm[:, 1], triangles, color="0.88", linewidth=0.4, zorder=0)
    size = np.linalg.norm(moved_mm, axis=1)
    bent = axes.tripcolor(x, z, size, triangles=triangles, shading="gouraud")
    axes.plot(x[base], z[base], color="white", linewidth=1.2)
    axes.figure.colorbar(bent, ax=axes, label="displacement [mm]")
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", title=title)
    return axes


def picture(draw: Callable[[Axes], object], alternative: str) -> str:
    """HTML of what `draw` puts on axes, and of the words `alternative` for those who do not see it."""
    from matplotlib.figure import Figure

    figure, file = Figure(figsize=(7, 3.5), layout="constrained"), io.BytesIO()
    draw(figure.subplots())
    figure.savefig(file, format="png", dpi=110)
    return f'<img alt="{alternative}" src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'
