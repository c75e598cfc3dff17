"""Make examples/finger.msh with Gmsh: half of a finger with rounded chambers, in tetrahedra.

    pip install gmsh
    python examples/make_finger_mesh.py
    python -m pgdl_lab finger=mesh finger.path=examples/finger.msh finger.max_kpa=30 task=simulate

The finger lies as `finger=mesh` wants it: x from the clamp to the tip, z up, y to the side, here only its half y ≥ 0.
What names the groups is `physical surface` in Gmsh; the physical volume has to be named too, or Gmsh leaves it out.
"""

from pathlib import Path

import gmsh
import numpy as np

LENGTH_MM, HALF_WIDTH_MM, HEIGHT_MM = 46.0, 8.0, 14.0
FIRST_MM, PITCH_MM, CHAMBERS = 4.0, 10.0, 4
RADIUS_MM = 1.5  # of the rounded edges of chambers
CHAMBER_MM = np.array([7.0, 5.0, 8.0])  # length, half width, height
FLOOR_MM = 3.0
CHANNEL_MM = np.array([1.5, 2.0])  # half width, height
NOTCH_MM, NOTCH_FLOOR_MM = 1.0, 8.0
EDGE_MM = 3.0


def box(low: np.ndarray, high: np.ndarray) -> tuple[int, int]:
    """A box between two corners (3,) [mm]."""
    return 3, gmsh.model.occ.addBox(*low, *(high - low))


def chamber(x: float) -> tuple[int, int]:
    """A chamber that begins at `x` [mm], whole across y = 0, with rounded edges."""
    low = np.array([x, -CHAMBER_MM[1], FLOOR_MM])
    volume = box(low, low + CHAMBER_MM * [1, 2, 1])
    gmsh.model.occ.synchronize()
    edges = gmsh.model.getBoundary(gmsh.model.getBoundary([volume], oriented=False), combined=False, oriented=False)
    (rounded,) = gmsh.model.occ.fillet([volume[1]], sorted({tag for _, tag in edges}), [RADIUS_MM])
    return rounded


def body() -> None:
    """The half finger less its cavity and the notches between the chambers."""
    starts = FIRST_MM + PITCH_MM * np.arange(CHAMBERS)
    channel = box(
        np.array([0.0, -CHANNEL_MM[0], FLOOR_MM + RADIUS_MM]),
        np.array([starts[-1] + 3, CHANNEL_MM[0], FLOOR_MM + RADIUS_MM + CHANNEL_MM[1]]),
    )
    middles = starts[1:] - (PITCH_MM - CHAMBER_MM[0]) / 2
    notches = [
        box(
            np.array([x - NOTCH_MM / 2, -1.0, NOTCH_FLOOR_MM]),
            np.array([x + NOTCH_MM / 2, HALF_WIDTH_MM + 1, HEIGHT_MM + 1]),
        )
        for x in middles
    ]
    solid = box(np.zeros(3), np.array([LENGTH_MM, HALF_WIDTH_MM, HEIGHT_MM]))
    gmsh.model.occ.cut([solid], [channel, *map(chamber, starts), *notches])
    gmsh.model.occ.synchronize()


def name_groups() -> None:
    """Sort the surfaces by where they lie: inner ones, those of the clamp and those in the plane of symmetry."""
    groups: dict[str, list[int]] = {"clamp": [], "symmetry": [], "cavity": []}
    inner = np.array([0.0, CHAMBER_MM[1], FLOOR_MM + CHAMBER_MM[2]])
    for _, tag in gmsh.model.getEntities(2):
        low, high = np.split(np.array(gmsh.model.getBoundingBox(2, tag)), 2)
        if high[0] < 1e-3:
            groups["clamp"].append(tag)
        elif high[1] < 1e-3:
            groups["symmetry"].append(tag)
        elif (high[1:] < inner[1:] + 1e-3).all() and low[2] > FLOOR_MM - 1e-3:
            groups["cavity"].append(tag)
    for number, (name, surfaces) in enumerate(groups.items(), start=1):
        gmsh.model.addPhysicalGroup(2, surfaces, number, name)
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 4, "body")


def main() -> None:
    """Write the mesh beside this script."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    body()
    name_groups()
    gmsh.option.setNumber("Mesh.MeshSizeMax", EDGE_MM)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 4)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 1.0)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("Netgen")
    gmsh.write(str(Path(__file__).with_name("finger.msh")))
    gmsh.finalize()


if __name__ == "__main__":
    main()
