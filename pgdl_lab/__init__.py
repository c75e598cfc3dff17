"""pgdl_lab: surrogate models of pneumatic soft fingers, learnt from finite elements, with a number for their error.

    import pgdl_lab as lab

    finger = lab.Pneunet(chambers=6)
    data = lab.simulate(finger)                # kept, so that the next call is at once
    surrogate = lab.train(data, model="pod")   # the same defaults as the command line
    surrogate.predict([[50.0, 0.0]], pressure_kpa=30.0)  # u_x, u_z [mm] at x = 50, z = 0 mm
    surrogate.error                            # at points that it was not trained on [mm]
    surrogate.plot(30.0)
    surrogate.save("finger.pt")                # lab.load("finger.pt") reads it again

`simulate`, `train` and `load` do the work; see `help(pgdl_lab.train)`. What can be chosen is a class with its settings
as fields: fingers (`Pneunet`, `Bellows`, `Joints`, `MeshFinger`), materials (`Yeoh`, `Ogden` ...), finite elements
(`Solid`, `Rod` ...), models (`Hybrid`, `Pod`, `Mlp` ...), losses and splits; `dir(pgdl_lab)` lists them all. Lengths
are in mm, pressures in kPa.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

try:
    __version__ = version("pgdl_lab")
except PackageNotFoundError:  # run from a checkout that is not installed
    __version__ = "0+checkout"

_HOMES = {
    "BalancingSettings": "learning.balancing",
    "Dataset": "core.dataset",
    "ExtrudedFinger": "mechanics.finger",
    "Fem": "mechanics.fem",
    "Finger": "mechanics.finger",
    "InputError": "core.errors",
    "LabError": "core.errors",
    "Loss": "learning.loss",
    "Material": "mechanics.material",
    "Mechanics": "mechanics.derived",
    "Model": "learning.model",
    "Observation": "core.observation",
    "OptimizerSettings": "learning.settings",
    "Outside": "surrogate.limits",
    "PhysicsLoss": "learning.loss",
    "Probe": "surrogate.probe",
    "Record": "surrogate.record",
    "SimulationStopped": "mechanics.fem",
    "Split": "core.split",
    "Surrogate": "surrogate.surrogate",
    "TooFar": "surrogate.limits",
    "TrainerSettings": "learning.settings",
    "TrainingDiverged": "learning.module",
    "discover": "core.registry",
    "load": "surrogate.loading",
    "register": "core.registry",
    "simulate": "api",
    "train": "api",
}
"""Where each public name is defined; each is imported when it is first asked for, as some bring PyTorch with them."""

__all__ = list(_HOMES)  # `help(pgdl_lab)` describes these


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = getattr(import_module(f"pgdl_lab.{_HOMES[name]}"), name)
    elif name[:1].isupper() and name in (classes := _plugin_classes()):
        value = classes[name]
    else:
        raise AttributeError(f"module 'pgdl_lab' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({"__doc__", "__version__", *_HOMES, *_plugin_classes()})


def _plugin_classes() -> dict[str, type]:
    """The plugins that come with the lab, by the names of their classes."""
    from pgdl_lab.core.registry import shipped_classes

    return {cls.__name__: cls for cls in shipped_classes()}
