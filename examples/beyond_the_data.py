"""Trained up to 80 % of the pressure and asked beyond: whether the error bars hold.

python examples/beyond_the_data.py
"""

import numpy as np

import pgdl_lab as lab

finger = lab.Pneunet(chambers=3, max_kpa=30.0)
data = lab.simulate(finger, lab.Solid(edge_mm=6.0), observation=lab.Observation(snapshots=30, points=600))

surrogate = lab.train(data, "pod", split=lab.ExtrapolateSplit(points=900, train_fraction=0.8, tested=[0.9, 1.0]))
surrogate.outside = "ignore"  # no warning at each question beyond the training

print("pressure   largest error   error bar   errors within it")
for kpa, truth in zip(data.pressures_kpa[14::5], data.displacements[14::5], strict=True):
    error = np.abs(surrogate.predict(data.domain.points_mm, kpa) - truth)
    bar = surrogate.error_bar(data.domain.points_mm, kpa)
    within = (error <= bar[:, None]).mean()
    print(f"{kpa:5.1f} kPa   {error.max():10.2g} mm   {np.median(bar):6.2g} mm   {within:6.0%}")

try:
    surrogate.predict(data.domain.points_mm, 100.0)
except lab.TooFar as refused:
    print("At 100 kPa:", refused)
