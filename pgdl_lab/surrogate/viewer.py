"""The finger in one HTML file: its surrogate, evaluated in the browser, and what the finite elements say beside it."""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.domain import Domain
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.probe import Probe

Floats = NDArray[np.float64]

TEMPLATE = Path(__file__).with_name("viewer.html")
DEGREES = (10, 16, 24, 40)  # in the pressure, tried one after the other
CLOSE_MM = 1e-4  # a polynomial this close to the surrogate stands for it
CHECKED = 25  # pressures at which that is checked
SHOWN = 21  # snapshots that are kept at most
COLOURS = {"size": "viridis", "error": "magma", "signed": "RdYlBu_r"}


class Surrogate(Protocol):
    """What the page needs of a surrogate."""

    model: dict[str, Any]

    @property
    def domain(self) -> Domain: ...
    @property
    def ranges(self) -> dict[str, list[float]]: ...
    def probe(self, points_mm: Floats) -> Probe: ...
    def trained_kpa(self) -> tuple[float, float]: ...
    def allowed_kpa(self) -> tuple[float, float]: ...


def page(surrogate: Surrogate, snapshots: Dataset | None, title: str) -> str:
    """The HTML text.

    Parameters
    ----------
    surrogate
        The surrogate; it knows its face.
    snapshots
        The simulation that it was trained on, to be shown beside it; None shows the surrogate alone.
    title
        Heading of the page.
    """
    content = json.dumps(_content(surrogate, snapshots, title)).replace("</", "<\\/")
    text = TEMPLATE.read_text(encoding="utf-8")
    return text.replace("{{title}}", html.escape(title)).replace("{{content}}", content)


def polynomial(surrogate: Surrogate, high_kpa: float) -> tuple[Floats, float]:
    """Chebyshev coefficients (K, N, 2) of the nodes' displacements from 0 to `high_kpa`, and their largest error [mm].

    Exact for surrogates that are polynomials in the pressure; networks are interpolated.
    """
    probe = surrogate.probe(surrogate.domain.points_mm)
    checked = np.random.default_rng(0).uniform(-1, 1, CHECKED)
    truth = probe.values((checked + 1) / 2 * high_kpa)
    coefficients: NDArray[Any] = truth
    error_mm = np.inf
    for degree in DEGREES:
        at = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        values = probe.values((at + 1) / 2 * high_kpa)
        basis = Basis.of([(-1.0, 1.0)], degree)
        coefficients = np.linalg.solve(basis(at), values.reshape(degree + 1, -1))
        again = (basis(checked) @ coefficients).reshape(truth.shape)
        error_mm = float(np.abs(again - truth).max())
        if error_mm <= CLOSE_MM:
            break
    return coefficients.reshape(-1, *truth.shape[1:]), error_mm


def framed(surrogate: Surrogate, title: str) -> str:
    """HTML of a frame with the page of the surrogate alone, for a notebook."""
    return (
        f'<iframe srcdoc="{html.escape(page(surrogate, None, title))}" title="{html.escape(title)}" '
        'style="width:100%;height:520px;border:0"></iframe>'
    )


def _content(surrogate: Surrogate, snapshots: Dataset | None, title: str) -> dict[str, Any]:
    mesh, base = surrogate.domain.mesh, surrogate.domain.base
    kpa, simulated = _shown(surrogate, snapshots)
    coefficients, error_mm = polynomial(surrogate, float(kpa[-1]))
    predicted = surrogate.probe(mesh.points_mm).values(kpa)
    errors_mm = np.empty(0) if simulated is None else np.linalg.norm(predicted - simulated, axis=2)
    bent = predicted if simulated is None else simulated
    places = np.concatenate([mesh.points_mm[None], mesh.points_mm + bent]).reshape(-1, 2)
    return {
        "title": title,
        "model": surrogate.model["name"],
        "maxKpa": float(kpa[-1]),
        "shownKpa": kpa.tolist(),
        "trainedKpa": surrogate.ranges["pressure_kpa"],
        "polynomialErrorMm": error_mm,
        "boundsMm": [places.min(axis=0).tolist(), places.max(axis=0).tolist()],
        "points": _packed(mesh.points_mm, "<f4"),
        "triangles": _packed(mesh.simplices, "<u4"),
        "outline": _packed(mesh.outline[:, :2], "<u4"),
        "base": _packed(base, "<u4"),
        "terms": len(coefficients),
        "coefficients": _packed(coefficients, "<f4"),
        "femKpa": [] if simulated is None else kpa.tolist(),
        "fem": _packed(np.empty(0) if simulated is None else simulated, "<f4"),
        "errors": _packed(errors_mm, "<f4"),
        "colours": {name: _colours(colour) for name, colour in COLOURS.items()},
    }


def _shown(surrogate: Surrogate, snapshots: Dataset | None) -> tuple[Floats, Floats | None]:
    """Pressures (S,) [kPa] that the page is made for, and simulated displacements (S, N, 2) at them [mm]."""
    if snapshots is None:
        return np.linspace(0, surrogate.trained_kpa()[1], SHOWN), None
    count = int((snapshots.pressures_kpa <= surrogate.allowed_kpa()[1]).sum())
    chosen = np.unique(np.linspace(0, count - 1, min(SHOWN, count)).round().astype(int))
    return snapshots.pressures_kpa[chosen], snapshots.displacements[chosen]


def _packed(array: NDArray[Any], dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=dtype).tobytes()).decode()


def _colours(name: str) -> str:
    """256 colours, red, green and blue as bytes."""
    import matplotlib

    return _packed(255 * matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3].round(6), "u1")
