"""A user's script, for the type checker alone: mypy fails if it sees a fault in it, or none where one is named."""

import pgdl_lab as lab

finger = lab.Pneunet(chambers=2, material=lab.Yeoh(c1_mpa=0.12))
data = lab.simulate(finger, lab.Rod(), observation=lab.Observation(snapshots=10))
surrogate = lab.train(data, lab.Pod(degree=4), loss=["data", lab.BoundaryLoss(weight=0.5)])
mean: float = surrogate.predict([[20.0, 0.0]], pressure_kpa=5.0).mean()
surrogate.plot(5.0).set_title("bent")
answer = lab.load("surrogate.pt").pressure_for(tip=[None, -20.0])

lab.Pneunet(chmbers=2)  # type: ignore[call-arg]
lab.simulate(lab.Pod())  # type: ignore[arg-type]
lab.train(finger)  # type: ignore[arg-type]
surrogate.predict(pressure=5.0)  # type: ignore[call-arg]
_ = lab.Pneumatic  # type: ignore[attr-defined]
