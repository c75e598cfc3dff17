"""A trained model: predict, invert, save. Needs NumPy alone; models that are networks bring torch with them."""

from __future__ import annotations

import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.heard import WARNINGS
from pgdl_lab.core.plotting import plot_side
from pgdl_lab.core.simplices import place
from pgdl_lab.surrogate import archive
from pgdl_lab.surrogate.inverse import Answer, Inverse
from pgdl_lab.surrogate.limits import Limits, Outside, TooFar
from pgdl_lab.surrogate.probe import Probe
from pgdl_lab.surrogate.query import points_of, pressures_of
from pgdl_lab.surrogate.record import Record, arrays_of
from pgdl_lab.surrogate.shapes import Shapes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMAT = "pgdl_lab surrogate"
VERSION = 3
UNITS = {"points": "mm", "pressure": "kPa", "displacement": "mm"}

ERROR = "surrogate_error"  # in the provenance: what was found at points that were not trained on

Floats = NDArray[np.float64]


class Surrogate(ABC):
    """The displacement of the side face or of the whole body as a function of place and pressure.

    Threads may share one.

    Parameters
    ----------
    model
        Name and settings of the model that it was trained as.
    record
        What it remembers of its training.

    Attributes
    ----------
    outside
        What a question is answered with that the surrogate was not trained for, a pressure a little outside the trained
        ones or a point off the body: "warn" (once for each of the two), "raise" or "ignore".
    shapes
        What `state` must look like.
    limits
        The pressures that it was trained on, and those that it answers.
    knows_body
        Whether a point off the body counts as the nearest one on it; else it is answered where it lies.
    """

    shapes: ClassVar[Shapes] = {}
    knows_body: bool = True

    def __init__(self, model: Mapping[str, Any], record: Record) -> None:
        self.model = dict(model)
        self.record = record
        self.outside = "warn"
        self._warned: dict[str, object] = {}
        self.limits = Limits.of(record.ranges)
        self._last: tuple[Floats, Probe] | None = None  # control loops ask for the same points again and again

    @abstractmethod
    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that was learnt."""

    @abstractmethod
    def probe(self, points_mm: Floats) -> Probe:
        """The surrogate at checked points (N, d) [mm]; those off the body, see `knows_body`."""

    def __repr__(self) -> str:
        low, high = self.record.ranges["pressure_kpa"]
        finger = self.record.provenance.get("finger")
        of = " of the whole body" if self.dimension == 3 else ""
        of += f" of finger {finger['name']}" if isinstance(finger, dict) and "name" in finger else ""
        told = f", {self.error['rms_mm']:.2g} mm RMS off at points not trained on" if self.error else ""
        return f"<surrogate {self.model['name']}{of}: {low:g} to {high:g} kPa{told}>"

    @property
    def dimension(self) -> int:
        """Coordinates of a point: 2 of the side face, x and z; 3 of the whole body, x, y and z."""
        domain = self.record.domain
        return domain.points_mm.shape[1] if domain else 3 if "y_mm" in self.record.ranges else 2

    @property
    def units(self) -> dict[str, str]:
        """Units of points, pressure and displacement."""
        return dict(UNITS)

    @property
    def ranges(self) -> dict[str, list[float]]:
        """Least and greatest training value: "x_mm", of a body "y_mm", "z_mm" and "pressure_kpa"."""
        return {name: list(bounds) for name, bounds in self.record.ranges.items()}

    @property
    def provenance(self) -> dict[str, Any]:
        """Where its training data come from: finger, mesh, material, solver, versions."""
        return dict(self.record.provenance)

    @property
    def warnings(self) -> list[str]:
        """What its simulation and its training warned of, in sentences."""
        return list(self.record.provenance.get(WARNINGS, ()))

    @property
    def error(self) -> dict[str, float | None]:
        """Its error at points of the simulation that it was not trained on; empty where nobody looked.

        "rms_mm" and "largest_mm" [mm]; "tip_mm" and "tip_percent", the largest at the tip [mm, % of its way].
        """
        return dict(self.record.provenance.get(ERROR, {}))

    def plot(self, pressure_kpa: float, axes: Axes | None = None) -> Axes:
        """Draw the bent side face, or the body from the side, at a pressure [kPa] over its shape at rest.

        It is drawn on `axes`, or in a new figure of pyplot.

        Raises
        ------
        InputError
            See `predict`.
        """
        domain = self.domain
        moved_mm = self.predict(domain.points_mm, float(pressure_kpa))
        title = f"model {self.model['name']} at {pressure_kpa:g} kPa"
        return plot_side(domain, moved_mm, title, axes)

    def _repr_html_(self) -> str:
        """The viewer, for notebooks."""
        from pgdl_lab.surrogate.viewer import framed

        return framed(self, f"Surrogate “{self.model['name']}”")

    @property
    def domain(self) -> Domain:
        """The side face or the whole body.

        Raises
        ------
        InputError
            When it is not known.
        """
        if self.record.domain is None:
            raise InputError("This surrogate knows no face, as it was not trained by `python -m pgdl_lab`; do that.")
        return self.record.domain

    @property
    def tip_mm(self) -> Floats:
        """The end of the undeformed base line (d,) [mm]."""
        return self.domain.tip_mm

    def predict(self, points_mm: ArrayLike, pressure_kpa: ArrayLike, *, beyond: bool = False) -> Floats:
        """Displacement of points of the undeformed face or body.

        Parameters
        ----------
        points_mm
            (N, 2), x and z of the undeformed points; of a whole body (N, 3): x, y and z [mm].
        pressure_kpa
            A number or (P,) [kPa].
        beyond
            Whether pressures outside `allowed_kpa` are answered too, with whatever comes out.

        Returns
        -------
        (N, 2) float64 for one pressure, (P, N, 2) float64 for several: u_x and u_z [mm]. Of a body (N, 3) and
        (P, N, 3): u_x, u_y and u_z.

        Raises
        ------
        TooFar
            When a pressure lies outside `allowed_kpa`, unless `beyond`.
        InputError
            When a shape is wrong or a value is not a finite number; with outside="raise" also when a pressure or a
            point lies outside what was trained.
        """
        points, pressures = points_of(points_mm, self.dimension), pressures_of(pressure_kpa)
        self._check_pressures(points, pressures, beyond)
        probe = self._probed(points)
        return probe.values(pressures) if pressures.ndim else probe.value(float(pressures))

    def at(self, points_mm: ArrayLike, *, beyond: bool = False) -> At:
        """The surrogate at fixed points, for control loops: `at(points)(kpa)` is `predict(points, kpa)`, but faster.

        Raises
        ------
        InputError
            See `predict`.
        """
        points = points_of(points_mm, self.dimension)
        return At(self, points, self._probed(points), beyond)

    def bars(self, points_mm: Floats, pressures_kpa: Floats) -> Floats | None:
        """Error bars (P, N) [mm] at checked points (N, d) [mm] and pressures (P,) [kPa]; None: has none."""
        return None

    def error_bar(self, points_mm: ArrayLike, pressure_kpa: ArrayLike, *, beyond: bool = False) -> Floats | None:
        """What the model itself expects to err by: |error| of each component stays below it in 95 of 100 cases.

        Parameters
        ----------
        points_mm, pressure_kpa, beyond
            See `predict`. No bar is to be relied on outside `allowed_kpa` or off the body.

        Returns
        -------
        (N,) float64 for one pressure, (P, N) float64 for several [mm]; None of a model that cannot tell.

        Raises
        ------
        InputError
            When a shape is wrong or a value is not a finite number, or a pressure lies outside `allowed_kpa`, unless
            `beyond`.
        """
        points, pressures = points_of(points_mm, self.dimension), pressures_of(pressure_kpa)
        if not beyond:
            self._check_distance(pressures)
        bars = self.bars(points, np.atleast_1d(pressures))
        return bars if bars is None or pressures.ndim else bars[0]

    def pressure_for(
        self,
        *,
        tip: Sequence[float | None] | None = None,
        curvature: float | None = None,
        tolerance: float | None = None,
    ) -> Answer:
        """The pressure at which the tip is at a place, or the base line has a mean curvature.

        Parameters
        ----------
        tip
            x and z of the deformed tip, of a body x, y and z [mm]; None in place of one of them leaves it free.
        curvature
            Mean curvature of the base line [1/m], positive when the finger bends upwards.
        tolerance
            How far off still counts as reached [mm or 1/m]; by default 0.1 mm and 0.01 / m.

        Returns
        -------
        The pressure within the trained ones, and whether the target is reached; if not, the nearest that is.

        Raises
        ------
        InputError
            When not exactly one target is given, or it is not made of finite numbers.
        """
        return self._inverse.pressure_for(tip, curvature, tolerance)

    @cached_property
    def _inverse(self) -> Inverse:
        return Inverse(self.domain, self.probe, self.trained_kpa()[0], self.ranges["pressure_kpa"][1])

    def trained_kpa(self) -> tuple[float, float]:
        """Least and greatest pressure that count as trained [kPa]."""
        return self.limits.trained.low, self.limits.trained.high

    def allowed_kpa(self) -> tuple[float, float]:
        """Least and greatest pressure that is answered [kPa], see `Limits.of`."""
        return self.limits.allowed.low, self.limits.allowed.high

    def save(self, path: str | Path) -> None:
        """Write the surrogate to `path`, in the safetensors format; the file appears there only when it is complete."""
        record = self.record
        about = {
            "format": FORMAT,
            "version": VERSION,
            "model": self.model,
            "record": {"ranges": record.ranges, "provenance": record.provenance, "history": record.history},
            "provenance_hash": record.provenance_hash,
            "units": UNITS,
        }
        archive.write(Path(path), about, state=self.state(), face=arrays_of(record.domain) if record.domain else {})

    def _probed(self, points_mm: Floats) -> Probe:
        """The probe of these points, which are checked; that of the last ones is kept."""
        last = self._last
        if last is not None and np.array_equal(last[0], points_mm):
            return last[1]
        self._check_points(points_mm)
        probe = self.probe(points_mm)
        self._last = points_mm.copy(), probe
        return probe

    def _settled(self, what: str) -> bool:
        """Whether nothing more is to be said of "points" or "pressures" outside."""
        return self.outside == "ignore" or (self.outside == "warn" and what in self._warned)

    def _check_points(self, points_mm: Floats) -> None:
        domain = self.record.domain
        if domain is None or self._settled("points") or not len(points_mm):
            return
        distance_mm = domain.mesh.distance_mm(points_mm, *domain.locate(points_mm))
        off = np.flatnonzero(distance_mm > domain.mesh.tolerance_mm)
        if len(off):
            self._complain(
                "points",
                lambda: (
                    f"{len(off)} of {len(points_mm)} points lie off the undeformed body, such as "
                    f"{place(points_mm[distance_mm.argmax()])} by {distance_mm.max():.3g} mm: give points in mm on the "
                    "body; each "
                    f"{'counts as the nearest point on it' if self.knows_body else 'is answered where it lies'}"
                    ", and no error bar tells how far off that is."
                ),
            )

    def _check_pressures(self, points_mm: Floats, pressures_kpa: Floats, beyond: bool) -> None:
        trained = self.limits.trained
        if trained.holds(pressures_kpa):
            return
        if not beyond:
            self._check_distance(pressures_kpa)
        if self._settled("pressures"):
            return

        def message() -> str:
            farthest = trained.farthest(pressures_kpa)
            return (
                f"{farthest:g} kPa lies outside the trained {self._trained()} kPa: give pressures in kPa within them, "
                f"or take the answer as an extrapolation{self._told_bar(points_mm, farthest)}."
            )

        self._complain("pressures", message)

    def _check_distance(self, pressures_kpa: Floats) -> None:
        """Refuse pressures outside `allowed_kpa`."""
        allowed = self.limits.allowed
        if not allowed.holds(pressures_kpa):
            raise TooFar(
                f"{allowed.farthest(pressures_kpa):g} kPa lies too far outside the trained {self._trained()} kPa for "
                f"an answer to be worth anything: give pressures in kPa from {allowed.low:g} to {allowed.high:g}, "
                "train on higher ones, or pass beyond=True for whatever comes out."
            )

    def _trained(self) -> str:
        return "{:g} to {:g}".format(*self.record.ranges["pressure_kpa"])

    def _told_bar(self, points_mm: Floats, kpa: float) -> str:
        bars = self.bars(points_mm, np.array([kpa])) if len(points_mm) else None
        return " without an error bar" if bars is None else f", with an error bar of up to {bars.max():.2g} mm"

    def _complain(self, what: str, message: Callable[[], str]) -> None:
        if self.outside == "raise":
            raise InputError(message())
        own = object()
        if self._warned.setdefault(what, own) is own:  # true of one thread alone
            warnings.warn(message(), Outside, stacklevel=_outside_this_file())


def _outside_this_file() -> int:
    """The stack level, from the function that calls this one, of the line that asked a surrogate something."""
    level, frame = 1, sys._getframe(1)
    while frame.f_code.co_filename == __file__ and frame.f_back is not None:
        level, frame = level + 1, frame.f_back
    return level


class At:
    """A surrogate at fixed points; see `Surrogate.at`.

    Parameters
    ----------
    surrogate
        The surrogate.
    points_mm
        (N, d), checked points [mm].
    probe
        The surrogate at them.
    beyond
        Whether any pressure is answered.
    """

    def __init__(self, surrogate: Surrogate, points_mm: Floats, probe: Probe, beyond: bool = False) -> None:
        self._surrogate, self._points_mm, self._probe, self._beyond = surrogate, points_mm, probe, beyond
        trained, allowed = surrogate.limits.trained, surrogate.limits.allowed
        largest = sys.float_info.max  # infinite pressures are named below
        self._low, self._high = max(trained.least, -largest), min(trained.most, largest)
        self._least, self._most = (-largest, largest) if beyond else (allowed.least, allowed.most)

    def __call__(self, pressure_kpa: float) -> Floats:
        """Displacement (N, d) [mm] at a pressure [kPa]."""
        return self._probe.value(self._checked(pressure_kpa))

    def slope(self, pressure_kpa: float) -> Floats:
        """Derivative (N, d) of the displacement by the pressure [mm/kPa]."""
        return self._probe.slope(self._checked(pressure_kpa))

    def _checked(self, kpa: float) -> float:
        try:
            if self._low <= kpa <= self._high:  # not so for NaN
                return float(kpa)
            if self._least <= kpa <= self._most and self._surrogate._settled("pressures"):
                return float(kpa)
        except (TypeError, ValueError):
            pass  # what is no number is named below
        pressure = pressures_of(kpa)
        if pressure.ndim:
            raise InputError(f"pressure_kpa has shape {pressure.shape}; it must be one number in kPa, or use predict.")
        self._surrogate._check_pressures(self._points_mm, pressure, self._beyond)
        return float(pressure)
