"""A trained model: predict, invert, save. Needs NumPy alone; models that are networks bring torch with them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pgdl_lab.core.domain import Domain
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.heard import WARNINGS
from pgdl_lab.core.inputs import PRESSURE
from pgdl_lab.core.plotting import plot_side
from pgdl_lab.surrogate import archive
from pgdl_lab.surrogate.at import At
from pgdl_lab.surrogate.inverse import Answer, Inverse
from pgdl_lab.surrogate.limits import along
from pgdl_lab.surrogate.outside import Watched
from pgdl_lab.surrogate.probe import Case, Probe
from pgdl_lab.surrogate.query import Asked, cases_of, points_of
from pgdl_lab.surrogate.record import Record, arrays_of
from pgdl_lab.surrogate.shapes import Shapes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMAT = "pgdl_lab surrogate"
VERSION = 3
UNITS = {"points": "mm", "pressure": "kPa", "displacement": "mm"}

ERROR = "surrogate_error"  # in the provenance: what was found at points that were not trained on

Floats = NDArray[np.float64]


class Surrogate(Watched):
    """The displacement of the side face or of the whole body as a function of place and inputs.

    Threads may share one.

    The input is the pressure, or there are several, each with a name that ends with its unit. What is said of a
    pressure below holds for a case of these too, where it is given as {"pressure_kpa": 20.0, "gravity_deg": 30.0}.

    Parameters
    ----------
    model
        Name and settings of the model that it was trained as.
    record
        What it remembers of its training.

    Attributes
    ----------
    outside
        What a question is answered with that the surrogate was not trained for, an input a little outside the trained
        ones or a point off the body: "warn" (once for each of the two), "raise" or "ignore".
    shapes
        What `state` must look like.
    limits
        Of each input the values that it was trained on, and those that it answers.
    inputs
        Names of the inputs.
    knows_body
        Whether a point off the body counts as the nearest one on it; else it is answered where it lies.
    """

    shapes: ClassVar[Shapes] = {}

    def __init__(self, model: Mapping[str, Any], record: Record) -> None:
        super().__init__(record)
        self.model = dict(model)
        self._last: tuple[Floats, Probe] | None = None  # control loops ask for the same points again and again

    @abstractmethod
    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that was learnt."""

    @abstractmethod
    def probe(self, points_mm: Floats) -> Probe:
        """The surrogate at checked points (N, d) [mm]; those off the body, see `knows_body`."""

    def __repr__(self) -> str:
        finger = self.record.provenance.get("finger")
        of = " of the whole body" if self.dimension == 3 else ""
        of += f" of finger {finger['name']}" if isinstance(finger, dict) and "name" in finger else ""
        told = f", {self.error['rms_mm']:.2g} mm RMS off at points not trained on" if self.error else ""
        heads = ["" if name == PRESSURE else f"{name} from " for name in self.inputs]
        known = zip(heads, map(self.trained_range, self.limits), strict=True)
        ranges = ", ".join(head + values for head, values in known)
        return f"<surrogate {self.model['name']}{of}: {ranges}{told}>"

    @property
    def dimension(self) -> int:
        """Coordinates of a point: 2 of the side face, x and z; 3 of the whole body, x, y and z."""
        domain = self.record.domain
        return domain.points_mm.shape[1] if domain else 3 if "y_mm" in self.record.ranges else 2

    @property
    def units(self) -> dict[str, str]:
        """Units of points, inputs and displacement."""
        known = {limit.name.removesuffix("_kpa"): limit.unit for limit in self.limits}
        return {"points": UNITS["points"], **known, "displacement": UNITS["displacement"]}

    @property
    def ranges(self) -> dict[str, list[float]]:
        """Least and greatest training value: "x_mm", of a body "y_mm", "z_mm" and each input: "pressure_kpa"."""
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

    def plot(self, pressure_kpa: Asked, axes: Axes | None = None) -> Axes:
        """Draw the bent side face, or the body from the side, at a pressure [kPa] over its shape at rest.

        It is drawn on `axes`, or in a new figure of pyplot.

        Raises
        ------
        InputError
            See `predict`.
        """
        domain = self.domain
        moved_mm = self.predict(domain.points_mm, pressure_kpa)
        if moved_mm.ndim != 2:
            raise InputError("A picture shows one case: give one value of each input.")
        (case,), _ = cases_of(pressure_kpa, self.inputs)
        where = [limit.told(value) for limit, value in zip(self.limits, np.atleast_1d(case), strict=True)]
        title = f"model {self.model['name']} at {', '.join(where)}"
        return plot_side(domain, moved_mm, title, axes)

    def _repr_html_(self) -> str:
        """The viewer, for notebooks."""
        from pgdl_lab.surrogate.viewer import framed

        middle = {limit.name: (limit.trained.low + limit.trained.high) / 2 for limit in self.limits[1:]}
        told = "".join(f", {name} = {value:g}" for name, value in middle.items())
        return framed(self.holding(**middle) if middle else self, f"Surrogate “{self.model['name']}”{told}")

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

    def predict(self, points_mm: ArrayLike, pressure_kpa: Asked, *, beyond: bool = False) -> Floats:
        """Displacement of points of the undeformed face or body.

        Parameters
        ----------
        points_mm
            (N, 2), x and z of the undeformed points; of a whole body (N, 3): x, y and z [mm].
        pressure_kpa
            A number or (P,) [kPa]. With several inputs numbers or (P,) of each by its name.
        beyond
            Whether inputs outside those allowed, see `limits`, are answered too, with whatever comes out.

        Returns
        -------
        (N, 2) float64 for one pressure, (P, N, 2) float64 for several: u_x and u_z [mm]. Of a body (N, 3) and
        (P, N, 3): u_x, u_y and u_z.

        Raises
        ------
        TooFar
            When an input lies outside those allowed, unless `beyond`.
        InputError
            When a shape is wrong or a value is not a finite number; with outside="raise" also when an input or a
            point lies outside what was trained.
        """
        points, (cases, single) = points_of(points_mm, self.dimension), cases_of(pressure_kpa, self.inputs)
        self.check_cases(points, cases, beyond)
        probe = self._probed(points)
        if not single:
            return probe.values(cases)
        return probe.value(float(cases[0]) if cases.ndim == 1 else cases[0])

    def at(self, points_mm: ArrayLike, *, beyond: bool = False) -> At:
        """The surrogate at fixed points, for control loops: `at(points)(kpa)` is `predict(points, kpa)`, but faster.

        Raises
        ------
        InputError
            See `predict`.
        """
        points = points_of(points_mm, self.dimension)
        return At(self, points, self._probed(points), beyond)

    def bars(self, points_mm: Floats, cases: Floats) -> Floats | None:
        return None

    def along(self, cases: Floats) -> Floats:
        """See `limits.along`."""
        return along(cases, [self.record.ranges[name] for name in self.inputs]) if cases.ndim > 1 else cases

    def error_bar(self, points_mm: ArrayLike, pressure_kpa: Asked, *, beyond: bool = False) -> Floats | None:
        """What the model itself expects to err by: |error| of each component stays below it in 95 of 100 cases.

        Parameters
        ----------
        points_mm, pressure_kpa, beyond
            See `predict`. No bar is to be relied on outside the allowed inputs or off the body.

        Returns
        -------
        (N,) float64 for one pressure, (P, N) float64 for several [mm]; None of a model that cannot tell.

        Raises
        ------
        InputError
            When a shape is wrong or a value is not a finite number, or an input lies outside those allowed, unless
            `beyond`.
        """
        points, (cases, single) = points_of(points_mm, self.dimension), cases_of(pressure_kpa, self.inputs)
        if not beyond:
            self.check_distance(cases)
        bars = self.bars(points, cases)
        return bars[0] if single and bars is not None else bars

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
            When not exactly one target is given, it is not made of finite numbers, or there are several inputs.
        """
        return self._inverse.pressure_for(tip, curvature, tolerance)

    @cached_property
    def _inverse(self) -> Inverse:
        if len(self.inputs) > 1:
            others = ", ".join(f"{name}=…" for name in self.inputs[1:])
            raise InputError(f"A pressure is sought at fixed other inputs: ask surrogate.holding({others}).")
        return Inverse(self.domain, self.probe, self.limits[0].trained.low, self.ranges[self.inputs[0]][1])

    def holding(self, **values: float) -> Surrogate:
        """The surrogate with all inputs but the first held at `values`, so that it is one of the first alone.

        Raises
        ------
        InputError
            When an input is missing or unknown, or a value lies outside what is allowed.
        """
        case, _ = cases_of({self.inputs[0]: self.limits[0].trained.low, **values}, self.inputs)
        self.check_distance(case)
        return Holding(self, case.reshape(-1)[1:])

    def trained_kpa(self) -> tuple[float, float]:
        """Least and greatest pressure that count as trained [kPa]."""
        return self.limits[0].trained.low, self.limits[0].trained.high

    def allowed_kpa(self) -> tuple[float, float]:
        """Least and greatest pressure that is answered [kPa], see `Limits.of`."""
        return self.limits[0].allowed.low, self.limits[0].allowed.high

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
        self.check_points(points_mm)
        probe = self.probe(points_mm)
        self._last = points_mm.copy(), probe
        return probe


class Holding(Surrogate):
    """A surrogate of the first input alone; see `Surrogate.holding`.

    Parameters
    ----------
    whole
        That of all inputs.
    others
        (D − 1,), values of the inputs after the first.
    """

    def __init__(self, whole: Surrogate, others: Floats) -> None:
        ranges = {name: bounds for name, bounds in whole.record.ranges.items() if name not in whole.inputs[1:]}
        super().__init__(whole.model, replace(whole.record, ranges=ranges))
        self.knows_body, self.outside = whole.knows_body, whole.outside
        self._whole, self._others = whole, others

    def state(self) -> dict[str, NDArray[Any]]:
        raise InputError("A surrogate whose inputs are held is not kept: save the one of all inputs.")

    def probe(self, points_mm: Floats) -> Probe:
        return _Slice(self._whole.probe(points_mm), self._others)

    def bars(self, points_mm: Floats, cases: Floats) -> Floats | None:
        return self._whole.bars(points_mm, np.column_stack([cases, np.tile(self._others, (len(cases), 1))]))


class _Slice(Probe):
    """A probe of the first input alone."""

    def __init__(self, probe: Probe, others: Floats) -> None:
        self._probe, self._others = probe, others

    def value(self, case: Case) -> Floats:
        return self._probe.value(np.array([case, *self._others]))

    def slope(self, case: Case) -> Floats:
        return self._probe.slope(np.array([case, *self._others]))[..., 0]
