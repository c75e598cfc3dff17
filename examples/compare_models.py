"""Which model learns most from few points, and how long it takes.

python examples/compare_models.py
"""

import time

import pgdl_lab as lab

finger = lab.Pneunet(chambers=3, max_kpa=30.0)
data = lab.simulate(finger, lab.Solid(edge_mm=6.0), observation=lab.Observation(snapshots=30, points=600))

few = lab.RandomSplit(points=200)
models = [lab.Hybrid(), lab.Pod(), lab.FiniteElement(), lab.GaussianProcess(), lab.Mlp(width=32, depth=3)]
budget = lab.TrainerSettings(max_time="10", progress=False)

print(f"{'model':20} {'RMS error':>12} {'largest':>12} {'training':>10}")
for model in models:
    began = time.perf_counter()
    surrogate = lab.train(data, model, split=few, trainer=budget)
    seconds = time.perf_counter() - began
    error = surrogate.error
    name = type(model).__name__
    print(f"{name:20} {error['rms_mm']:9.3g} mm {error['largest_mm']:9.3g} mm {seconds:8.1f} s")
