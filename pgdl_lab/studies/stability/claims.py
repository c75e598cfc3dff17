"""What each warning of the lab claims to be wrong."""

import re
from dataclasses import dataclass

from pgdl_lab.studies.stability.outcome import ACCURACY, CONTACT, DATA, RANGE, TRAINING, UNSTABLE

REMARK = "remark"
"""Says nothing of the error of this result."""
UNKNOWN = "unknown"
"""A sentence that no rule knows: it names nothing until it has one."""
NUMBER = r"[-+]?\d[\d.]*(?:e[-+]?\d+)?"

RULES = (
    (UNSTABLE, "are unstable"),
    (UNSTABLE, "gives way sideways"),
    (CONTACT, "Surfaces pass through each other"),
    (ACCURACY, "On a mesh with half the edges the tip would lie"),
    (ACCURACY, "discretisation error could not be estimated, so it may be large"),
    (ACCURACY, "its element is some 10 % off"),
    (ACCURACY, "does not know its own error"),
    (ACCURACY, "The finger is short for fem=rod"),
    (DATA, "No training point lies within"),
    (DATA, "own error bars are .* its data are too few or too noisy"),
    (DATA, "are too few to tell how far the model errs"),
    (REMARK, "no time to train without parts of the points"),
    (TRAINING, "has not learnt its own training points"),
    (RANGE, "lies outside the trained"),
    (REMARK, "uses second derivatives, which are zero everywhere"),
    (REMARK, "leaves out loss"),
    (REMARK, "pod alone answers"),
    (REMARK, "The checkpoint could not be written"),
    (REMARK, "so there are none: give it more"),
)


STATED = re.compile("would lie .* mm elsewhere|own error bars|with an error bar of up to")
"""In a warning that says how large the error may be."""


@dataclass(frozen=True)
class Claim:
    """What a warning says is wrong.

    Attributes
    ----------
    cause
        One of `outcome.CAUSES`, `REMARK` or `UNKNOWN`.
    stated
        Whether it says how large the error may be.
    """

    cause: str
    stated: bool = False


def claim(sentence: str) -> Claim:
    """What a sentence claims, by the first rule that knows it."""
    cause = next((cause for cause, pattern in RULES if re.search(pattern, sentence)), UNKNOWN)
    return Claim(cause, bool(STATED.search(sentence)))
