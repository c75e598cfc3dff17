"""Pictures of a finger for a notebook, from its side: the bent face or body, coloured by how far its points move."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pgdl_lab.core.domain import Domain

FACING = 0.5  # y of the unit normal from which on a facet is seen


def from_the_side(domain: Domain) -> NDArray[np.int64]:
    """Triangles (T, 3) that one sees of a domain from the side: all of a face; of a body those that look to +y."""
    if not domain.is_body:
        return domain.mesh.simplices
    outline = domain.mesh.outline
    a, b, c, inside = np.moveaxis(domain.points_mm[outline], 1, 0)
    normal = np.cross(b - a, c - a)
    normal *= np.sign(((a - inside) * normal).sum(axis=1))[:, None]
    seen = normal[:, 1] > FACING * np.linalg.norm(normal, axis=1)
    depth = domain.points_mm[outline[seen, :3], 1].mean(axis=1)
    return outline[seen, :3][depth.argsort(kind="stable")]  # the nearest last, over the others


def plot_side(domain: Domain, moved_mm: NDArray[np.float64], title: str, axes: Axes | None = None) -> Axes:
    """Draw a bent face or body over its shape at rest, from the side.

    Parameters
    ----------
    domain
        The face or the body at rest.
    moved_mm
        (N, d), displacements of its points [mm].
    axes
        Where to draw, by default in a new figure of pyplot.
    """
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(figsize=(7, 3.5), layout="constrained")[1]
    triangles, plane = from_the_side(domain), [0, -1]  # x and z
    at_rest, (x, z) = domain.points_mm[:, plane], (domain.points_mm + moved_mm)[:, plane].T
    axes.triplot(at_rest[:, 0], at_rest[:, 1], triangles, color="0.88", linewidth=0.4, zorder=0)
    size = np.linalg.norm(moved_mm, axis=1)
    bent = axes.tripcolor(x, z, size, triangles=triangles, shading="gouraud")
    axes.plot(x[domain.base], z[domain.base], color="white", linewidth=1.2)
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
