"""A surrogate as one graph, for torch.export and ONNX: any number of points and of pressures, displacements out."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.export import Dim

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.simplices import SimplexMesh
from pgdl_lab.learning.field import PlaneField
from pgdl_lab.learning.modal import ModalField
from pgdl_lab.learning.neural_surrogate import NeuralSurrogate
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.nodal_surrogate import NodalSurrogate
from pgdl_lab.surrogate.surrogate import Surrogate

ON_BODY = -1e-6  # least weight of a point on the body; off it the graph answers with NaN
ARGUMENTS = ("points_mm", "pressure_kpa")


class Graph(nn.Module):
    """Displacements (P, N, d) float64 [mm] of points (N, d) float64 [mm] at pressures (P,) float64 [kPa].

    Parameters
    ----------
    surrogate
        What it is made of.
    """

    def forward(self, points_mm: Tensor, pressure_kpa: Tensor) -> Tensor:
        raise NotImplementedError


class Allowed(Graph):
    """A graph that answers with NaN to pressures outside `Surrogate.allowed_kpa`, as there is no one to refuse them.

    Parameters
    ----------
    inner
        The graph.
    low_kpa, high_kpa
        Least and greatest pressure that is answered [kPa].
    """

    def __init__(self, inner: Graph, low_kpa: float, high_kpa: float) -> None:
        super().__init__()
        self.inner, self.low_kpa, self.high_kpa = inner, low_kpa, high_kpa

    def forward(self, points_mm: Tensor, pressure_kpa: Tensor) -> Tensor:
        allowed = (pressure_kpa >= self.low_kpa) & (pressure_kpa <= self.high_kpa)
        return torch.where(allowed[:, None, None], self.inner(points_mm, pressure_kpa), torch.nan)


class Interpolation(nn.Module):
    """Nodal values (M, …) of a face or body, linearly interpolated; NaN off the body.

    Parameters
    ----------
    mesh
        The face.
    """

    origin_mm: Tensor
    table: Tensor
    first_mm: Tensor
    slopes: Tensor
    triangles: Tensor

    def __init__(self, mesh: SimplexMesh) -> None:
        super().__init__()
        origin_mm, self.cell_mm, table = mesh.grid
        first_mm, slopes = mesh.affine
        self.register_buffer("origin_mm", torch.from_numpy(origin_mm))
        self.register_buffer("table", torch.from_numpy(table))
        self.register_buffer("first_mm", torch.from_numpy(first_mm))
        self.register_buffer("slopes", torch.from_numpy(slopes))
        self.register_buffer("triangles", torch.from_numpy(mesh.simplices))

    def forward(self, points_mm: Tensor, nodal: Tensor) -> Tensor:
        place = torch.floor((points_mm - self.origin_mm) / self.cell_mm)
        cells = [place[:, axis].clamp(0, cells - 1).long() for axis, cells in enumerate(self.table.shape[:-1])]
        candidates = self.table[tuple(cells)]  # −1 is the last simplex, which a point may be in or not, as any other
        offset = (points_mm[:, None] - self.first_mm[candidates])[..., None, :]
        later = (offset * self.slopes[candidates]).sum(dim=-1)
        weights = torch.cat([1 - later.sum(dim=-1, keepdim=True), later], dim=-1)
        best = weights.amin(dim=-1).argmax(dim=1, keepdim=True)
        weights = torch.gather(weights, 1, best[..., None].expand(-1, 1, weights.shape[2]))[:, 0]
        corners = self.triangles[torch.gather(candidates, 1, best)[:, 0]]
        values = (weights.clamp(min=0)[..., None] * nodal[corners]).sum(dim=1)
        return torch.where(weights.amin(dim=1, keepdim=True) < ON_BODY, torch.nan, values)


class NodalGraph(Graph):
    """See `NodalSurrogate`."""

    modes: Tensor
    amplitudes_mm: Tensor

    def __init__(self, surrogate: NodalSurrogate) -> None:
        super().__init__()
        state = surrogate.state()
        self.interpolation = Interpolation(SimplexMesh(state["points_mm"], state["triangles"]))
        self.basis = Basis.restored(state, len(state["amplitudes"]))
        self.dimension = surrogate.dimension
        self.register_buffer("modes", torch.from_numpy(state["modes"]).flatten(1))
        self.register_buffer("amplitudes_mm", torch.from_numpy(state["amplitudes"]))

    def forward(self, points_mm: Tensor, pressure_kpa: Tensor) -> Tensor:
        local = self.interpolation(points_mm, self.modes).unflatten(1, (-1, self.dimension))
        flat = (
            torch.stack(self.basis.terms([pressure_kpa]), dim=1) @ self.amplitudes_mm @ local.transpose(0, 1).flatten(1)
        )
        return flat.unflatten(1, (-1, self.dimension))


class PlaneGraph(Graph):
    """A network of place and pressure; it knows no body."""

    def __init__(self, field: PlaneField) -> None:
        super().__init__()
        self.layers, self.dtype = field.layers, field.dtype

    def forward(self, points_mm: Tensor, pressure_kpa: Tensor) -> Tensor:
        pressures, points = pressure_kpa.shape[0], points_mm.shape[0]
        inputs = torch.cat(
            [points_mm.expand(pressures, points, -1), pressure_kpa[:, None, None].expand(pressures, points, 1)], dim=2
        )
        return self.layers(inputs.to(self.dtype)).double()


class ModalGraph(Graph):
    """A network on the body's eigenfunctions; see `ModalField`."""

    modes: Tensor

    def __init__(self, field: ModalField) -> None:
        super().__init__()
        self.field = field
        self.interpolation = Interpolation(field.body)
        self.register_buffer("modes", field.modes.double())

    def forward(self, points_mm: Tensor, pressure_kpa: Tensor) -> Tensor:
        coordinates = self.interpolation(points_mm, self.modes)[None].to(self.field.dtype)
        return self.field.displacements(coordinates, pressure_kpa[:, None].to(self.field.dtype)).double()


def graph_of(surrogate: Surrogate) -> Graph:
    """The graph of a surrogate.

    Raises
    ------
    InputError
        When its model has none, or it has several inputs.
    """
    if len(surrogate.inputs) > 1:
        raise InputError(f"A graph takes the pressure alone, and this surrogate {', '.join(surrogate.inputs)}.")
    allowed = surrogate.limits[0].allowed
    return Allowed(_any_pressure(surrogate), allowed.least, allowed.most).eval()


def _any_pressure(surrogate: Surrogate) -> Graph:
    if isinstance(surrogate, NodalSurrogate):
        return NodalGraph(surrogate)
    field = surrogate.field if isinstance(surrogate, NeuralSurrogate) else None
    if isinstance(field, PlaneField):
        return PlaneGraph(field)
    if isinstance(field, ModalField):
        return ModalGraph(field)
    raise InputError(f"Model {surrogate.model['name']} cannot be exported as a graph: use its surrogate.pt.")


def program_of(graph: Graph, dimension: int = 2) -> torch.export.ExportedProgram:
    """The exported program, with any number of points (N, `dimension`) and of pressures."""
    points, pressures = torch.zeros(3, dimension, dtype=torch.double), torch.zeros(2, dtype=torch.double)
    sizes = {"points_mm": {0: Dim("points", min=1)}, "pressure_kpa": {0: Dim("pressures", min=1)}}
    return torch.export.export(graph, (points, pressures), dynamic_shapes=sizes)


def write_program(program: torch.export.ExportedProgram, path: Path) -> None:
    """Write a file for `torch.export.load`."""
    with quiet(), replacing(path) as temporary, temporary.open("wb") as file:
        torch.export.save(program, file)


def write_onnx(program: torch.export.ExportedProgram, path: Path) -> None:
    """Write an ONNX file: inputs "points_mm" (N, d) and "pressure_kpa" (P,), output "displacement_mm" (P, N, d).

    Raises
    ------
    InputError
        When the packages of the extra `export` are missing.
    """
    try:
        import onnxscript  # noqa: F401 (PyTorch needs it here, and says so in many lines)
    except ImportError as error:
        raise InputError("ONNX files need more packages: pip install 'pgdl_lab[export]'.") from error
    with quiet(), replacing(path) as temporary:
        converted = torch.onnx.export(
            program, dynamo=True, input_names=ARGUMENTS, output_names=["displacement_mm"], verbose=False
        )
        assert converted is not None
        converted.save(temporary)


@contextmanager
def quiet() -> Iterator[None]:
    """Without the exporters' remarks on themselves."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        yield
    for logger, level in zip(loggers, levels, strict=True):
        logger.setLevel(level)
