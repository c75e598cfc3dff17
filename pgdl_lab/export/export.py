"""All forms of a surrogate: written, read back, and compared with the original on random queries."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.export import numpy_form
from pgdl_lab.surrogate.surrogate import Surrogate

Floats = NDArray[np.float64]
Predict = Callable[[Floats, Floats], Floats]
"""Displacements (P, N, d) [mm] from points (N, d) [mm] and pressures (P,) [kPa]."""

BATCHES, BATCH = 100, 100  # pressures, and points at each of them
TOLERANCE_MM = {"float64": 1e-9, "float32": 1e-3}  # rounding of sums of some 100 mm, through a dozen layers


@dataclass(frozen=True)
class Form:
    """A form that a surrogate was exported to.

    Attributes
    ----------
    name
        "numpy", "torch.export" or "onnx".
    path
        Its file.
    predict
        What was read back from it.
    difference_mm
        Largest difference from the original over the random queries [mm].
    tolerance_mm
        What it had to stay below [mm].
    """

    name: str
    path: Path
    predict: Predict
    difference_mm: float
    tolerance_mm: float


def export(surrogate: Surrogate, folder: Path) -> Iterator[Form | InputError]:
    """Write every form of `surrogate` to `folder`; one that its model or this machine cannot have comes as the reason.

    Raises
    ------
    LabError
        When a form does not give the numbers of the original.
    """
    folder.mkdir(exist_ok=True)
    tolerance_mm = TOLERANCE_MM[surrogate.model.get("dtype", "float64")]
    for name, make in (("numpy", _numpy), ("torch.export", _program), ("onnx", _onnx)):
        try:
            path, predict = make(surrogate, folder)
        except InputError as reason:
            yield reason
            continue
        difference_mm = largest_difference_mm(surrogate, predict)
        if not difference_mm <= tolerance_mm:
            raise LabError(f"{path} differs from the original by {difference_mm:.3g} mm, more than {tolerance_mm:g}.")
        yield Form(name, path, predict, difference_mm, tolerance_mm)


def random_queries(surrogate: Surrogate) -> Iterator[tuple[Floats, Any]]:
    """Points (100, d) [mm], even over the body, and a pressure (1,) [kPa] or a case of all inputs, 100 times."""
    rng = np.random.default_rng(0)
    mesh = surrogate.domain.mesh
    corners = mesh.points_mm[mesh.simplices]
    legs = corners[:, 1:] - corners[:, :1]
    area = np.abs(np.linalg.det(legs))
    for _ in range(BATCHES):
        chosen = rng.choice(len(corners), BATCH, p=area / area.sum())
        points = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(corners.shape[1]), BATCH), corners[chosen])
        case = {limit.name: rng.uniform(limit.trained.low, limit.trained.high, 1) for limit in surrogate.limits}
        yield points, case if len(case) > 1 else case[surrogate.inputs[0]]


def largest_difference_mm(surrogate: Surrogate, predict: Predict) -> float:
    """Over all `random_queries`; not a number if one answer is none [mm]."""
    differences = [
        np.abs(predict(points, kpa) - surrogate.predict(points, kpa)).max() for points, kpa in random_queries(surrogate)
    ]
    return float(np.max(differences))


def _numpy(surrogate: Surrogate, folder: Path) -> tuple[Path, Predict]:
    from pgdl_lab.surrogate.loading import load

    path = folder / "surrogate.npz"
    numpy_form.write(surrogate, path)
    return path, load(path, outside="ignore").predict


def _program(surrogate: Surrogate, folder: Path) -> tuple[Path, Predict]:
    import torch

    from pgdl_lab.export.torch_form import graph_of, program_of, quiet, write_program

    path = folder / "surrogate.pt2"
    write_program(program_of(graph_of(surrogate), surrogate.dimension), path)
    with quiet():
        module = torch.export.load(path).module()

    @torch.no_grad()
    def predict(points_mm: Floats, pressures_kpa: Floats) -> Floats:
        return module(torch.from_numpy(points_mm), torch.from_numpy(pressures_kpa)).numpy()

    return path, predict


def _onnx(surrogate: Surrogate, folder: Path) -> tuple[Path, Predict]:
    from pgdl_lab.export.torch_form import graph_of, program_of, write_onnx

    path = folder / "surrogate.onnx"
    write_onnx(program_of(graph_of(surrogate), surrogate.dimension), path)
    return path, read_onnx(path)


def read_onnx(path: Path, threads: int = 1) -> Predict:
    """The session of an ONNX file.

    Raises
    ------
    InputError
        When onnxruntime is missing.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError("ONNX files need more packages: pip install 'pgdl_lab[export]'.") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])

    def predict(points_mm: Floats, pressures_kpa: Floats) -> Floats:
        answer: list[Floats] = session.run(None, {"points_mm": points_mm, "pressure_kpa": pressures_kpa})
        return answer[0]

    return predict
