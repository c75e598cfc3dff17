"""The bench that methods are measured on: one scene, its reference, and a store of what was measured."""

import hashlib
import json
import logging
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.assessment.latency import median_ms
from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import LabError
from pgdl_lab.core.files import replacing
from pgdl_lab.learning.doubt import trained
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.running.cache import simulate, snapshot_path
from pgdl_lab.running.experiment import Experiment
from pgdl_lab.studies.chart.point import Point
from pgdl_lab.studies.chart.reference import Errors, Reference, find_reference
from pgdl_lab.studies.chart.settings import ChartSettings
from pgdl_lab.surrogate.surrogate import Surrogate

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Bench:
    """A scene and what all methods are measured with.

    Attributes
    ----------
    experiment
        Finger, data and split; its model and training are those of the method in question.
    settings
        Of the chart.
    folder
        Where simulations and measured points are kept, below `snapshots` and `chart`.
    """

    experiment: Experiment
    settings: ChartSettings
    folder: Path

    @cached_property
    def reference(self) -> Reference:
        """The converged reference."""
        experiment, settings = self.experiment, self.settings
        judged = settings.judgement(experiment.observation)
        return find_reference(experiment.finger, settings.reference, judged, self.folder / "snapshots")

    @cached_property
    def data(self) -> Dataset:
        """The simulation that surrogates learn from; its discretisation error is known here without an estimate."""
        experiment = self.experiment
        return simulate(experiment.finger, self.plain_fem, experiment.observation, self.folder / "snapshots")[0]

    @cached_property
    def plain_fem(self) -> Fem:
        """The finite-element model of the data, without an estimate of its error."""
        return without_estimate(self.experiment.fem)

    @cached_property
    def data_name(self) -> str:
        """Name of the file of the data, which tells everything that determines them."""
        experiment = self.experiment
        return snapshot_path(Path(), experiment.finger, self.plain_fem, experiment.observation).name

    @cached_property
    def train(self) -> NDArray[np.int64]:
        """Indices (n,) of the training points."""
        return self.experiment.split.train_points(self.data, self.experiment.seed)

    @cached_property
    def judged(self) -> NDArray[np.int64]:
        """Indices of the judged pressures among those of the data."""
        return self.reference.among(self.data.pressures_kpa)

    @cached_property
    def discretisation(self) -> Errors:
        """Error of the data."""
        return self.reference.errors(self.data.displacements[self.judged])

    def measured(self, label: str, kind: str, key: Any, measure: Callable[[], Point]) -> tuple[Point, bool]:
        """The point of a method from the store, or measured now; and whether it was there. A failure is a point too.

        Parameters
        ----------
        key
            All that determines the result beside the reference, code included (JSON types).
        """
        digest = hashlib.sha256()
        references = [path.name for path in self.reference.paths]
        digest.update(json.dumps([label, kind, key, references], sort_keys=True, default=str).encode())
        path = self.folder / "chart" / f"{digest.hexdigest()[:20]}.json"
        if path.is_file():
            return Point.restored(json.loads(path.read_text(encoding="utf-8"))), True
        began = time.perf_counter()
        _log.info("%s: measuring ...", label)
        try:
            point = measure()
        except LabError as error:
            point = Point(label, kind, failed=str(error))
        _log.info("%s: measured in %.1f s", label, time.perf_counter() - began)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(asdict(point), indent=1), encoding="utf-8")
        return point, False

    def trained(self, how: Experiment) -> tuple[Surrogate, float]:
        """A surrogate trained as `how` says on the data of this bench, and the time it took [s]."""
        own = self.experiment
        with tempfile.TemporaryDirectory() as folder:
            quiet = replace(how, finger=own.finger, seed=own.seed, trainer=replace(how.trainer, progress=False))
            training = quiet.training(self.data, self.train, Path(folder), provenance={})
            began = time.perf_counter()
            surrogate = trained(how.model, training)
            return surrogate, time.perf_counter() - began

    def judge(
        self, label: str, kind: str, train_s: float, predict: Callable[[NDArray[np.float64], float], Any],
        seen: NDArray[np.bool_],
    ) -> Point:  # fmt: skip
        """The point of something that learnt from the data.

        Parameters
        ----------
        predict
            From points (N, 2) [mm] and a pressure [kPa] to displacements (N, 2) [mm].
        seen
            (P, N) the data that it was given.
        """
        points, tip, kpa = self.data.domain.points_mm, self.reference.tip, float(self.data.pressures_kpa[-1])
        predicted = np.stack([predict(points, float(p)) for p in self.data.pressures_kpa[self.judged]])
        unseen = ~seen[self.judged]
        unseen[~unseen.any(axis=1)] = True  # of a snapshot that was given as a whole, training errors stand in
        if not np.isfinite(predicted).all():
            return Point(label, kind, failed="it predicts what is not a number")
        return Point(
            label,
            kind,
            self.data.provenance["seconds"],
            train_s,
            median_ms(lambda: predict(points, kpa)),
            median_ms(lambda: predict(points[tip : tip + 1], kpa)),
            self.reference.errors(predicted, unseen),
            self.discretisation,
            Errors.of(predicted - self.data.displacements[self.judged], tip, unseen),
            warnings=self.data.warnings,
        )


def without_estimate(fem: Fem) -> Fem:
    """`fem` without an estimate of its discretisation error, if it makes one."""
    given: Any = fem
    return replace(given, estimate_error=False) if getattr(fem, "estimate_error", False) else fem
