"""A hand that turns: a few simulations, one surrogate for all directions of gravity between them.

python examples/several_inputs.py
"""

import numpy as np

import pgdl_lab as lab

OBSERVATION = lab.Observation(snapshots=20, points=300)


def simulated(angle_deg: float) -> lab.Dataset:
    """A finger that is held at an angle, by the rod, which takes a second; `lab.Solid()` is exact and takes longer."""
    angle = np.deg2rad(angle_deg)
    gravity = [9.81 * float(np.sin(angle)), 0.0, -9.81 * float(np.cos(angle))]
    finger = lab.Pneunet(chambers=4, max_kpa=20.0, gravity_m_s2=gravity)
    return lab.simulate(finger, lab.Rod(), observation=OBSERVATION)


angles = [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0]
data = lab.Dataset.joined([simulated(angle) for angle in angles], gravity_deg=angles)
surrogate = lab.train(data, lab.Pod(), split=lab.RandomSplit(points=2000))
print(surrogate)

for angle in (-45.0, 10.0, 75.0):  # nobody simulated these
    truth = simulated(angle)
    case = {"pressure_kpa": truth.pressures_kpa, "gravity_deg": angle}
    error = np.abs(surrogate.predict(truth.domain.points_mm, case) - truth.displacements)
    bars = surrogate.error_bar(truth.domain.points_mm, case)
    assert bars is not None
    print(
        f"{angle:4g}°: {np.sqrt((error**2).sum(axis=2).mean()):.1e} mm RMS off, the bar is {np.median(bars):.1e} mm "
        f"and covers {(error <= bars[..., None]).mean():.0%}"
    )

held = surrogate.holding(gravity_deg=20.0)  # one input again: loops, inverse questions and the viewer take it
tip = held.tip_mm + held.predict([held.tip_mm], 12.0)[0]
print(f"At 20° the tip is at {tip.round(2)} mm at 12 kPa. {held.pressure_for(tip=(tip[0], None))}")
