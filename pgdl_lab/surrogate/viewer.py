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
Ints = NDArray[np.int64]

TEMPLATE, BODY_TEMPLATE = (Path(__file__).with_name(name) for name in ("viewer.html", "viewer_body.html"))
STYLE = Path(__file__).with_name("viewer.css")
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
        The surrogate; it knows its face or its body.
    snapshots
        The simulation that it was trained on, to be shown beside it; None shows the surrogate alone.
    title
        Heading of the page.
    """
    body = surrogate.domain.is_body
    content = json.dumps((_body_content if body else _content)(surrogate, snapshots, title)).replace("</", "<\\/")
    text = (BODY_TEMPLATE if body else TEMPLATE).read_text(encoding="utf-8")
    text = text.replace("{{style}}", STYLE.read_text(encoding="utf-8"))
    return text.replace("{{title}}", html.escape(title)).replace("{{content}}", content)


def polynomial(surrogate: Surrogate, high_kpa: float, nodes: Ints | None = None) -> tuple[Floats, float]:
    """Chebyshev coefficients (K, N, d) of the displacements from 0 to `high_kpa`, and their largest error [mm].

    Those of all nodes, or of some (N,). Exact for surrogates that are polynomials in the pressure; networks are
    interpolated.
    """
    points_mm = surrogate.domain.points_mm
    probe = surrogate.probe(points_mm if nodes is None else points_mm[nodes])
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


def _body_content(surrogate: Surrogate, snapshots: Dataset | None, title: str) -> dict[str, Any]:
    domain = surrogate.domain
    nodes, skin, section = _surface(domain)
    kpa, simulated = _shown(surrogate, snapshots)
    coefficients, error_mm = polynomial(surrogate, float(kpa[-1]), nodes)
    rest_mm = domain.points_mm[nodes]
    predicted = surrogate.probe(rest_mm).values(kpa)
    errors_mm = np.empty(0) if simulated is None else np.linalg.norm(predicted - simulated[:, nodes], axis=2)
    places = np.concatenate([rest_mm[None], rest_mm + predicted]).reshape(-1, 3)
    if len(section):  # a half, which is shown with its mirror image
        places = np.concatenate([places, places * [1, -1, 1]])
    root = rest_mm[rest_mm[:, 0] <= rest_mm[:, 0].min() + 1e-3]
    tip = np.linalg.norm(rest_mm - domain.tip_mm, axis=1).argmin() if len(domain.base) else None
    return {
        "title": title,
        "model": surrogate.model["name"],
        "maxKpa": float(kpa[-1]),
        "shownKpa": kpa.tolist(),
        "trainedKpa": surrogate.ranges["pressure_kpa"],
        "polynomialErrorMm": error_mm,
        "boundsMm": [places.min(axis=0).tolist(), places.max(axis=0).tolist()],
        "clampMm": [root.min(axis=0).tolist(), root.max(axis=0).tolist()],
        "tip": None if tip is None else int(tip),
        "points": _packed(rest_mm, "<f4"),
        "skin": _packed(skin, "<u4"),
        "section": _packed(section, "<u4"),
        "terms": len(coefficients),
        "coefficients": _packed(coefficients, "<f4"),
        "errors": _packed(errors_mm, "<f4"),
        "colours": {name: _colours(colour) for name, colour in COLOURS.items()},
    }


def _surface(domain: Domain) -> tuple[Ints, Ints, Ints]:
    """Nodes (n,) of the surface of a body, and its triangles (T, 3) of them, without and within the plane of symmetry.

    A body is a half where none of it lies at y < 0 and some of its surface in the plane y = 0.
    """
    facets = domain.mesh.outline[:, :3]
    nodes, renumbered = np.unique(facets, return_inverse=True)
    triangles, y = renumbered.reshape(-1, 3), domain.points_mm[:, 1]
    near_mm = domain.mesh.tolerance_mm / 1e3
    flat = (np.abs(y[facets]) <= near_mm).all(axis=1) & (y.min() >= -near_mm)
    return nodes, triangles[~flat], triangles[flat]


def _shown(surrogate: Surrogate, snapshots: Dataset | None) -> tuple[Floats, Floats | None]:
    """Pressures (S,) [kPa] that the page is made for, and simulated displacements (S, N, d) at them [mm]."""
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
