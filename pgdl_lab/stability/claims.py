"""What each warning of the lab claims to be wrong."""

import re
from dataclasses import dataclass

from pgdl_lab.stability.outcome import ACCURACY, CONTACT, DATA, RANGE, TRAINING, UNSTABLE

REMARK = "remark"
"""Says nothing of the error of this result."""
UNKNOWN = "unknown"
"""A sentence that no rule knows: it names nothing until it has one."""
NUMBER = r"[-+]?\d[\d.]*(?:e[-+]?\d+)?"

RULES = (
    (UNSTABLE, "are unstable"),
    (UNSTABLE, "gives way sideways"),
    (CONTACT, "Surfaces pass through each other"),
    (ACCURACY, f"On a mesh with half the edges the tip would lie .* kPa, (?P<percent>{NUMBER}) % of its displacement"),
    (ACCURACY, "discretisation error could not be estimated, so it may be large"),
    (ACCURACY, "its element is some 10 % off"),
    (ACCURACY, "does not know its own error"),
    (ACCURACY, "The finger is short for fem=rod"),
    (DATA, "No training point lies within"),
    (DATA, "its data are too few or too noisy"),
    (DATA, "Error bars are calibrated on .* too few to trust them"),
    (TRAINING, "has not learnt its own training points"),
    (RANGE, "lies outside the trained"),
    (REMARK, "uses second derivatives, which are zero everywhere"),
    (REMARK, "leaves out loss"),
    (REMARK, "The checkpoint could not be written"),
    (REMARK, "so there are none: give it more"),
)


@dataclass(frozen=True)
class Claim:
    """What a warning says is wrong.

    Attributes
    ----------
    cause
        One of `outcome.CAUSES`, `REMARK` or `UNKNOWN`.
    error
        The relative error that it states, if it does.
    """

    cause: str
    error: float | None = None


def claim(sentence: str) -> Claim:
    """What a sentence claims, by the first rule that knows it."""
    for cause, pattern in RULES:
        if found := re.search(pattern, sentence):
            percent = found.groupdict().get("percent")
            return Claim(cause, None if percent is None else float(percent) / 100)
    return Claim(UNKNOWN)
