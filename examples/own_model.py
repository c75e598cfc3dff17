"""A model of your own beside those of the lab: here, one that moves in proportion to the pressure.

    python examples/own_model.py

In a file of `plugins/model/` it can be typed as `model=lines`, takes part in sweeps and can be loaded again.
"""

from dataclasses import dataclass

import numpy as np

import pgdl_lab as lab
from pgdl_lab.core.registry import describe


class Lines(lab.Surrogate):
    """The nearest training point's displacement, in proportion to the pressure."""

    def __init__(self, model, record, state):
        super().__init__(model, record)
        self.points, self.slopes = state["points"], state["slopes"]

    def state(self):
        return {"points": self.points, "slopes": self.slopes}

    def probe(self, points_mm):
        distance = np.linalg.norm(points_mm[:, None] - self.points, axis=2)
        return Line(self.slopes[distance.argmin(axis=1)])


@dataclass
class Line(lab.Probe):
    """Fixed points (N, 2) that move in proportion to the pressure."""

    slopes: np.ndarray  # [mm/kPa]

    def value(self, kpa):
        return kpa * self.slopes


@lab.register("model", "lines")
@dataclass(frozen=True)
class LinesModel(lab.Model):
    """A straight line through the origin for each training point."""

    def fit(self, training):
        samples = training.whole
        state = {"points": samples.points_mm, "slopes": samples.displacements_mm / samples.pressures_kpa[:, None]}
        return self.restore(
            state, lab.Record(samples.ranges(), dict(training.provenance), domain=training.scene.kept_domain)
        )

    def restore(self, state, record):
        return Lines(describe(self), record, state)


finger = lab.Pneunet(chambers=3, max_kpa=30.0)
data = lab.simulate(finger, lab.Solid(edge_mm=6.0), observation=lab.Observation(snapshots=30, points=600))
for model in (LinesModel(), lab.Pod()):
    surrogate = lab.train(data, model, split=lab.RandomSplit(points=900))
    print(f"{describe(model)['name']}: {surrogate.error['rms_mm']:.2g} mm RMS")
