"""From a finger to its surrogate: simulate, train, ask, save.

    python examples/first_surrogate.py

A short finger of three chambers on a coarse mesh, so that it takes seconds.
"""

import numpy as np

import pgdl_lab as lab

finger = lab.Pneunet(chambers=3, max_kpa=30.0)
data = lab.simulate(finger, lab.Solid(edge_mm=6.0), observation=lab.Observation(snapshots=30, points=600))
print(data)

surrogate = lab.train(data, split=lab.RandomSplit(points=900))  # 5 % of the points; the model is the default one
print(
    f"error at the other 95 %: {surrogate.error['rms_mm']:.2g} mm RMS, {surrogate.error['largest_mm']:.2g} mm at most"
)

point = [[35.0, 0.0]]  # x and z of an undeformed point [mm]; several points are several rows
(u_x, u_z), bar = surrogate.predict(point, 12.5)[0], surrogate.error_bar(point, 12.5)[0]
print(f"at 12.5 kPa it moves by {u_x:.4f} and {u_z:.4f} mm, within {bar:.1g} mm in 95 of 100 cases")

x, z = surrogate.tip_mm
low = z + surrogate.predict([[x, z]], 12.5)[0, 1]
print("the tip is as low as it is there at", surrogate.pressure_for(tip=[None, float(low)]))

surrogate.plot(30.0).figure.savefig("first_surrogate.png")
surrogate.save("first_surrogate.pt")
again = lab.load("first_surrogate.pt")
assert np.array_equal(again.predict(point, 12.5), surrogate.predict(point, 12.5))
