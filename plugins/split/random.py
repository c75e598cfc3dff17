"""Split `random`: training points drawn from all snapshots (the paper's first approach)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import register
from pgdl_lab.core.split import Split


@register("split", "random")
@dataclass(frozen=True)
class RandomSplit(Split):
    """Points drawn at random from all cases (paper, section IV-A, first approach)."""

    def seen(self, cases: Cases) -> NDArray[np.bool_]:
        return np.ones(len(cases), dtype=bool)
