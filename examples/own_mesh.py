"""A surrogate of a finger of your own, from a mesh file.

    python examples/own_mesh.py

`examples/make_finger_mesh.py` writes the mesh that is read here. Its groups are named clamp, symmetry and cavity.
"""

from pathlib import Path

import pgdl_lab as lab

finger = lab.MeshFinger(path=str(Path(__file__).with_name("finger.msh")), max_kpa=10.0, material=lab.Yeoh(c1_mpa=0.1))
quick = lab.Solid(estimate_error=False)  # half the time, and no word on how far off the mesh is
data = lab.simulate(finger, quick, observation=lab.Observation(snapshots=10, points=500))
for warning in data.warnings:
    print("Told by the simulation:", warning)

surrogate = lab.train(data, "pod", split=lab.RandomSplit(points=500))
x, z = surrogate.tip_mm + surrogate.predict([surrogate.tip_mm], 10.0)[0]
print(f"At 10 kPa the tip is at x = {x:.2f}, z = {z:.2f} mm, {surrogate.error['tip_mm']:.1g} mm off at most.")
