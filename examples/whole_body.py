"""The whole body: a surrogate of all nodes, and what the mechanics make of its displacement.

python examples/whole_body.py
"""

import pgdl_lab as lab

finger = lab.Pneunet(chambers=3, max_kpa=30.0)
observation = lab.Observation(snapshots=30, points=600, of="body")
data = lab.simulate(finger, lab.Solid(edge_mm=6.0), observation=observation)
print(data)

surrogate = lab.train(data, "pod", split=lab.RandomSplit(points=10_000))
print(f"error at all other points: {surrogate.error['rms_mm']:.2g} mm RMS")

mechanics = lab.Mechanics.of(surrogate)
(at_rest,) = mechanics.chamber_volumes_mm3()  # the chambers of this finger are joined: they are one
print(f"the chamber holds {at_rest:.0f} mm³ at rest")
for kpa in (10.0, 20.0, 30.0):
    moved_mm = surrogate.predict(data.domain.points_mm, kpa)
    (volume,), stress = mechanics.chamber_volumes_mm3(moved_mm), mechanics.mean(mechanics.von_mises_mpa(moved_mm))
    print(f"at {kpa:g} kPa {volume:.0f} mm³, and von Mises' stress is up to {stress.max():.3f} MPa")
_, load = mechanics.reaction_n(moved_mm, 30.0)
print(f"the support carries {-load[2]:.3f} N, which is the weight: what closed chambers push on cancels")
