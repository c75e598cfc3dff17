"""The whole body for ParaView: a VTU file for each equilibrium, and a PVD file that puts them in a row."""

from pathlib import Path
from xml.sax.saxutils import quoteattr

from pgdl_lab.files import replacing
from pgdl_lab.snapshots import Body


def write_series(body: Body, folder: Path) -> Path:
    """Write the undeformed mesh [mm] with the displacements [mm]; what ParaView calls time is the pressure [kPa].

    Returns
    -------
    Path
        The PVD file to open.
    """
    import meshio

    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for number, (kpa, displacement) in enumerate(zip(body.pressures_kpa, body.displacements, strict=True)):
        name = f"body_{number:03d}.vtu"
        mesh = meshio.Mesh(body.positions, [(body.cell_type, body.cells)], {"displacement_mm": displacement})
        with replacing(folder / name) as temporary:
            mesh.write(temporary, file_format="vtu")
        entries.append(f'<DataSet timestep="{kpa:.9g}" file={quoteattr(name)}/>')
    series = folder / "body.pvd"
    with replacing(series) as temporary:
        temporary.write_text(
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>\n'
            + "\n".join(entries)
            + "\n</Collection></VTKFile>\n"
        )
    return series
