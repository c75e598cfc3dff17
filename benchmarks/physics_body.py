"""What the true balance of forces buys a network of the whole body: loss `equilibrium` beside data and boundary.

    python benchmarks/physics_body.py [--epochs 1500]

Trains `model=mlp` on the body of a finger of 2 chambers, for the same number of steps whatever the loss, from few and
from more points, up to 60 % of the highest pressure and over all. Given are the RMS error at the pressures within the
trained ones and at those above, what is out of balance at the highest trained and at the highest pressure (1 is no
displacement at all), and the processor time. `pod`, which takes no term, stands beside.
"""

import itertools
import time

import numpy as np

import pgdl_lab as lab
from benchmarks.common import parsed, parser, show, table
from pgdl_lab.learning.body_balance import body_balance
from pgdl_lab.learning.scene import Scene

TRAINED = 0.6  # of the highest pressure
WEIGHTS = (0.0, 0.01, 0.1)  # of the term


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--epochs", type=int, default=1500)
    arguments.add_argument("--points", type=int, nargs="+", default=[100, 1000])
    given = parsed(arguments, epochs=20, points=[100])
    finger = lab.Pneunet(chambers=2, max_kpa=10.0)
    seen = lab.Observation(snapshots=20, points=300, of="body")
    data = lab.simulate(finger, lab.Solid(edge_mm=8.0, estimate_error=False), observation=seen)
    within = data.pressures_kpa <= TRAINED * 10.0 + 1e-9
    balance = body_balance(Scene.of(finger, data))
    headings = ("model", "points", "RMS within mm", "RMS above mm", "out of balance", "above", "seconds")
    shown = table("Trained up to 6 of 10 kPa", headings, left=1)
    how = lab.TrainerSettings(max_epochs=given.epochs, progress=False, threads=1)
    rule = lab.OptimizerSettings(name="adam", lr=3e-3, batch_size=10**6)
    for count, weight in itertools.product(given.points, (None, *WEIGHTS)):
        split = lab.ExtrapolateSplit(points=count, train_fraction=TRAINED, tested=[1.0])
        term = [lab.EquilibriumLoss(weight=weight)] if weight else []
        network = lab.Mlp(width=48, depth=3, activation="tanh", dtype="float64")
        model = lab.Pod() if weight is None else network
        began = time.process_time()
        surrogate = lab.train(data, model, split=split, loss=["data", "boundary", *term], trainer=how, optimizer=rule)
        spent = time.process_time() - began
        surrogate.outside = "ignore"
        predicted = surrogate.predict(data.domain.points_mm, data.pressures_kpa, beyond=True)
        square = ((predicted - data.displacements) ** 2).sum(axis=2)
        left = [
            balance.evaluated(predicted[case], float(data.pressures_kpa[case]), slope=False)[0]
            for case in (int(within.sum()) - 1, -1)
        ]
        name = "pod" if weight is None else f"mlp, equilibrium × {weight:g}" if weight else "mlp, data alone"
        errors = (np.sqrt(square[which].mean()) for which in (within, ~within))
        shown.add_row(name, str(count), *(f"{value:.2g}" for value in (*errors, *left)), f"{spent:.0f}")
    show(shown)


if __name__ == "__main__":
    main()
