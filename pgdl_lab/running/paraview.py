"""Fields for ParaView: the whole body as VTU files in a row, the side face as an XDMF time series."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.dataset_file import writing
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing
from pgdl_lab.mechanics.derived import Mechanics
from pgdl_lab.surrogate.surrogate import Surrogate

_log = logging.getLogger(__name__)

Fields = dict[str, NDArray[np.float64]]


def write_series(body: Dataset, folder: Path) -> Path:
    """Write the undeformed mesh [mm] with the displacements [mm]; what ParaView calls time is the pressure [kPa].

    Returns
    -------
    Path
        The PVD file to open.
    """
    return _series(body, folder, lambda number: ({"displacement_mm": body.displacements[number]}, {}))


def write_body(surrogate: Surrogate, body: Dataset, folder: Path) -> Path:
    """Write what the finite elements and the surrogate say of the whole body, one VTU file per pressure.

    Fields at the nodes are those of `write_face`. Each element has "von_mises_mpa", the mean over it of von Mises'
    stress at the surrogate's displacement, where the mechanics of the body are known; not a number where that turns an
    element inside out.

    Returns
    -------
    Path
        The PVD file to open.
    """
    fields = _both(surrogate, body)
    try:
        mechanics = Mechanics.of(body)
    except InputError as reason:
        _log.warning("The files hold no stress: %s", reason)
        mechanics = None

    def at(number: int) -> tuple[Fields, Fields]:
        cells: Fields = {}
        if mechanics is not None:
            try:
                stress = mechanics.mean(mechanics.von_mises_mpa(fields["surrogate_mm"][number]))
            except InputError:
                stress = np.full(len(body.domain.cells), np.nan)
            cells = {"von_mises_mpa": stress}
        return {name: field[number] for name, field in fields.items()}, cells

    return _series(body, folder, at)


def _series(body: Dataset, folder: Path, at: Callable[[int], tuple[Fields, Fields]]) -> Path:
    """Write a VTU file for each case of `body`, with the fields of nodes and of elements that are `at` it."""
    import meshio

    folder.mkdir(parents=True, exist_ok=True)
    entries, domain = [], body.domain
    for number, kpa in enumerate(body.pressures_kpa):
        nodes, cells = at(number)
        name = f"body_{number:03d}.vtu"
        mesh = meshio.Mesh(
            domain.points_mm, [(domain.cell_type, domain.cells)], nodes, {key: [value] for key, value in cells.items()}
        )
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


def _both(surrogate: Surrogate, data: Dataset) -> Fields:
    """What finite elements and surrogate say: (P, N, d) [mm], and (P, N) [mm] where there are error bars."""
    predicted = surrogate.predict(data.domain.points_mm, data.pressures_kpa, beyond=True)
    bars = surrogate.error_bar(data.domain.points_mm, data.pressures_kpa, beyond=True)
    return {
        "fem_mm": data.displacements,
        "surrogate_mm": predicted,
        "difference_mm": predicted - data.displacements,
        **({} if bars is None else {"error_bar_mm": bars}),
    }


def write_face(surrogate: Surrogate, snapshots: Dataset, path: Path) -> None:
    """Write what the finite elements and the surrogate say of the side face, one step per snapshot.

    Fields: "fem_mm", "surrogate_mm" and "difference_mm" (surrogate less finite elements), as vectors in x, y and z, and
    "error_bar_mm" where the surrogate has one. What ParaView calls time is the pressure [kPa]. The numbers lie beside
    `path` in an HDF5 file.
    """
    domain = snapshots.domain
    known = _both(surrogate, snapshots)
    fields = {name: in_space(field) if field.ndim == 3 else field for name, field in known.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    numbers = path.with_suffix(".h5")
    with writing(numbers) as file:
        mesh = {"points": in_space(domain.points_mm), "triangles": domain.cells}
        grid = [_item(file, name, array, numbers.name) for name, array in mesh.items()]
        steps = []
        for number, kpa in enumerate(snapshots.pressures_kpa):
            attributes = [
                f'<Attribute Name="{name}" AttributeType="{"Vector" if field.ndim == 3 else "Scalar"}" Center="Node">'
                f"{_item(file, f'{name}/{number}', field[number], numbers.name)}</Attribute>"
                for name, field in fields.items()
            ]
            steps.append(
                f'<Grid GridType="Uniform"><Time Value="{float(kpa)!r}"/>'
                f'<Geometry GeometryType="XYZ">{grid[0]}</Geometry>'
                f'<Topology TopologyType="Triangle" NumberOfElements="{len(domain.cells)}">{grid[1]}</Topology>'
                + "".join(attributes)
                + "</Grid>"
            )
    with replacing(path) as temporary:
        temporary.write_text(
            '<Xdmf Version="3.0"><Domain>\n<Grid GridType="Collection" CollectionType="Temporal">\n'
            + "\n".join(steps)
            + "\n</Grid></Domain></Xdmf>\n"
        )


def in_space(plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (…, 2) along x and z as vectors (…, 3) along x, y and z."""
    return np.insert(plane, 1, 0.0, axis=-1)


def _item(file: Any, name: str, array: NDArray[Any], numbers: str) -> str:
    """Store `array` in the HDF5 `file` as `name`; the XML element that refers to it there."""
    file[name] = array
    kind = "Int" if array.dtype.kind == "i" else "Float"
    shape = " ".join(map(str, array.shape))
    return f'<DataItem Format="HDF" NumberType="{kind}" Precision="8" Dimensions="{shape}">{numbers}:/{name}</DataItem>'
