"""What a calibration searches: the dimensions that a finger leaves open, and the extremes that it is to meet.

Both can be written into a configuration: `${open_dimensions:FINGER}` and `${paper_extremes:FINGER}`.
"""

from pgdl_lab.assessment.paper import published
from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.finger import Finger

RELATIVE = 0.02  # tolerance of an extreme
LEAST_MM = 0.5  # where the paper has nearly nothing


def dimensions(finger: str) -> dict[str, str]:
    """Open dimensions of a finger as a search space.

    Raises
    ------
    InputError
        If there is no such finger, or it says nothing of open dimensions.
    """
    chosen: type[Finger] = registry.plugin("finger", finger)
    found = chosen.open_mm
    if not found:
        raise InputError(f"finger={finger} has no open dimensions (`open_mm`): set hydra.sweeper.params.")
    return {f"finger.{name}": f"interval({low},{high})" for name, (low, high) in found.items()}


def targets(finger: str) -> dict[str, list[float]]:
    """Least and greatest displacements in the paper's FEA at the highest pressure: [target, tolerance] by metric [mm].

    Raises
    ------
    InputError
        If the paper has none of this finger.
    """
    found = published(finger, "random").fem_mm
    if not found:
        raise InputError(f"The paper has no extremes of finger={finger}: set hydra.sweeper.targets.")
    return {
        f"extremes_mm.fem.{axis}.{end}": [value, RELATIVE * abs(value) if abs(value) > 1 else LEAST_MM]
        for axis, ends in found.items()
        for end, value in enumerate(ends)
    }
