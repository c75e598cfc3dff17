"""The three fingers beside the paper's FEA: extremes, errors, times, and docs/figures/fingers.png.

    python benchmarks/fingers.py            # snapshots from the cache where they are there
    python benchmarks/fingers.py --fresh    # everything computed anew

Extremes are those of the side face at the highest pressure. `seconds` is what the simulation took when it was computed,
on however busy a machine.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from benchmarks.common import folders, parsed, parser, show, table
from benchmarks.scenes import scene
from pgdl_lab.assessment.figures import STYLE
from pgdl_lab.assessment.paper import published
from pgdl_lab.core import paths
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import LabError
from pgdl_lab.running.cache import simulate

TITLES = {"pneunet": "PneuNets finger", "joints": "Finger with local bending joints", "bellows": "Bellows finger"}

LIGHT = np.array([-0.35, -0.75, 0.55])  # towards the lamp of the three-dimensional views
LEAST_LIGHT = 0.55
VIEW = {"elev": 18.0, "azim": -62.0}
COLOURS = "viridis"
REST = "0.88"

Array = NDArray[np.float64]


def rows(table: Table, finger: str, snapshots: Dataset) -> None:
    """Add one row for each extreme that the paper states."""
    last, known = snapshots.displacements[-1], snapshots.provenance
    error = known["discretisation_error"]
    tip = f"{error['tip_mm']:.2g} mm at the tip" if error else "not estimated"
    columns = [str(known["mesh"]["elements"]), f"{known['seconds']:.0f}", tip]
    title = f"{finger} at {snapshots.pressures_kpa[-1]:g} kPa"
    for axis, wanted in published(finger, "random").fem_mm.items():
        along = last[:, "xz".index(axis)]
        for label, paper, ours in zip(("min", "max"), wanted, (along.min(), along.max()), strict=True):
            difference = f"{ours - paper:+.3f}"
            relative = f"{abs(ours / paper - 1):.1%}" if abs(paper) > 1 else "–"
            table.add_row(title, f"u_{axis} {label}", f"{paper:g}", f"{ours:.3f}", difference, relative, *columns)
            title, columns = "", ["", "", ""]
    table.add_section()


def shell(body: Dataset) -> NDArray[np.int64]:
    """Corners (F, 4) of the outer facets of a half body of hexahedra, those in the plane y = 0 left out."""
    sides = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    facets = body.domain.cells[:, sides].reshape(-1, 4)
    _, first, count = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    outer = facets[first[count == 1]]
    return outer[~np.isclose(body.domain.points_mm[outer][:, :, 1], 0).all(axis=1)]


def draw_side(axis: Any, snapshots: Dataset, scale: Any) -> Any:
    """The side face at full pressure, coloured by |u|, over its shape at rest."""
    at_rest, shift = snapshots.domain.points_mm, snapshots.displacements[-1]
    triangles = snapshots.domain.cells
    axis.tripcolor(*at_rest.T, triangles, np.zeros(len(at_rest)), cmap="Greys", vmin=-0.12, vmax=1, shading="gouraud")
    axis.plot(*outline(at_rest, triangles), color="0.45", linewidth=0.6)
    size, now = np.linalg.norm(shift, axis=1), at_rest + shift
    drawn = axis.tripcolor(*now.T, triangles, size, cmap=COLOURS, norm=scale, shading="gouraud", rasterized=True)
    axis.plot(*outline(now, triangles), color="0.15", linewidth=0.5)
    return drawn


def outline(points: Array, triangles: NDArray[np.int64]) -> Array:
    """X and z (2, 3 B) of the edges that belong to one triangle, each followed by a gap."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    ends = points[edges[first[count == 1]]]
    return np.concatenate([ends, np.full((len(ends), 1, 2), np.nan)], axis=1).reshape(-1, 2).T


def draw_solid(axis: Any, body: Dataset, scale: Any) -> None:
    """The whole finger at full pressure, both halves."""
    from matplotlib import colormaps
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    half = shell(body)
    shift = body.displacements[-1]
    corners, sizes = (body.domain.points_mm + shift)[half], np.linalg.norm(shift, axis=1)[half].mean(axis=1)
    corners = np.concatenate([corners, (corners * [1, -1, 1])[:, ::-1]])
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    light = LEAST_LIGHT + (1 - LEAST_LIGHT) * np.clip(normal @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
    colours = colormaps[COLOURS](scale(np.tile(sizes, 2)))
    colours[:, :3] *= light[:, None]
    axis.add_collection3d(Poly3DCollection(corners, facecolors=colours, edgecolors=(0, 0, 0, 0.25), linewidths=0.15))
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axis.set_box_aspect(high - low)
    axis.view_init(**VIEW)
    axis.set_axis_off()


def draw(all_snapshots: dict[str, Dataset], path: Path) -> None:
    """Write the figure: side views on one scale above, the whole bodies below."""
    import matplotlib
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    most = max(np.linalg.norm(snapshots.displacements[-1], axis=1).max() for snapshots in all_snapshots.values())
    scale = Normalize(0, most)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13, 7.5), layout="constrained")
        grid = figure.add_gridspec(2, len(all_snapshots), height_ratios=(1.25, 1))
        sides: list[Any] = []
        for column, (finger, snapshots) in enumerate(all_snapshots.items()):
            shared = {"sharex": sides[0], "sharey": sides[0]} if sides else {}
            side = figure.add_subplot(grid[0, column], **shared)
            drawn = draw_side(side, snapshots, scale)
            side.set(
                xlabel="x [mm]",
                aspect="equal",
                title=f"{TITLES[finger]}\nat rest (grey) and at {snapshots.pressures_kpa[-1]:g} kPa",
            )
            sides.append(side)
            if snapshots.body is not None:
                draw_solid(figure.add_subplot(grid[1, column], projection="3d"), snapshots.body, scale)
        sides[0].set_ylabel("z [mm]")
        figure.colorbar(drawn, ax=figure.axes, label="displacement |u| [mm]", shrink=0.7, aspect=30)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)


def main() -> None:
    """Simulate, print the table, draw the figure."""
    arguments = parser(__doc__)
    arguments.add_argument("--fresh", action="store_true", help="leave the cache aside")
    given = parsed(arguments)
    headings = ("", "", "paper", "ours", "difference", "relative", "elements", "seconds", "discretisation error")
    shown = table("The paper's FEA and fem=solid, extremes in mm", headings, left=2)
    all_snapshots = {}
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) if given.fresh else paths.RUNS / "snapshots"
        for finger in TITLES:
            made = scene(finger, "fem.estimate_error=true", quick=given.quick)
            all_snapshots[finger], _, _ = simulate(made.finger, made.fem, made.observation, kept)
            rows(shown, finger, all_snapshots[finger])
    show(shown)
    path = folders("fingers", given.quick)[1] / "figures" / "fingers.png"
    draw(all_snapshots, path)
    print(f"written to {path}")


if __name__ == "__main__":
    try:
        main()
    except LabError as error:
        raise SystemExit(str(error)) from None
