"""Frictionless contact of a body with itself, by a barrier that keeps surfaces apart.

The potential of M. Li et al., Incremental Potential Contact, ACM Transactions on Graphics 39 (2020), as the IPC Toolkit
computes it: zero where surfaces are farther apart than a small reach, growing without bound as they meet. With it a
step of Newton's method ends before the first penetration. That holds from a start without one, which only the way
there can show: a body carried wholly through another crosses nothing at the end of it.
"""

import os
from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.crossing import CurvedFaces
from pgdl_lab.mechanics.elements import Discretisation
from pgdl_lab.mechanics.skin import MIRROR, skin
from pgdl_lab.mechanics.surface import MirrorPlane, Pairs, Surface
from pgdl_lab.mechanics.term import Response, Term
from pgdl_lab.mechanics.threads import threads

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Array = NDArray[np.float64]
Index = NDArray[np.int64]

REACH_MM = 0.05  # unless told otherwise
# Forces on quadratic faces come from samples, more of them than nodes: those of a uniform pressure are in error by the
# square of the distance of samples. Where faces are too narrow for three to an edge, two must do.
DIVISIONS = (3, 2)
MOST_DIVISIONS = 12  # where faces would pass through each other between fewer
TOUCHING = 1e-3  # reaches: what is nearer at rest leaves no room for a smaller reach
WIDEST_GAP = 10  # reaches: gaps up to it are measured


class Contact(Term):
    """What keeps the faces of a body apart: outside, in each chamber, and half a body from its mirror image.

    Parameters
    ----------
    discretisation
        The elements.
    reach_mm
        Distance below which surfaces push each other apart [mm].
    stiffness_mpa
        Scale of the contact pressure [MPa].
    mode
        "on": the barrier acts from the start; "auto": whoever finds that surfaces touch sets `active`; "off": it never
        acts, and surfaces may pass through each other.
    cut
        Named boundaries where the body goes on, so that nothing can touch it there.

    Raises
    ------
    InputError
        When contact is not "off", and surfaces cross at rest or are within twice the reach, through air.
    """

    def __init__(
        self,
        discretisation: Discretisation,
        reach_mm: float,
        stiffness_mpa: float,
        mode: str,
        cut: tuple[str, ...] = (MIRROR,),
    ) -> None:
        import ipctk

        ipctk.set_num_threads(min(threads(), os.cpu_count() or 1))  # it complains of more
        self.mode = mode
        self.active = mode == "on"
        self.reach_mm = reach_mm
        self._rest = np.zeros_like(discretisation.positions)
        self._positions, self._law = discretisation.positions, (reach_mm, stiffness_mpa)
        self._faces, self._held = skin(discretisation, cut), np.zeros(len(self._rest), dtype=bool)
        if mirror := bool(len((discretisation.basis.mesh.boundaries or {}).get(MIRROR, []))):
            self._held[discretisation.basis.get_dofs(MIRROR).all()] = True
        self._curved = CurvedFaces(self._faces, self._positions, mirror=mirror)
        for divisions in DIVISIONS:
            self._divisions, self._pairs = divisions, self._followed(divisions)
            # Triangles that share no vertex may be near each other at rest: a step, or the bottom of a gap.
            near_mm = min(pairs.apart_at_rest_mm for pairs in self._pairs)
            if not np.isfinite(near_mm):
                break
        if mode == "off":
            return
        for pairs in self._pairs:
            if pairs.apart_at_rest_mm < TOUCHING * reach_mm or pairs.penetrates(self._rest):
                raise InputError(
                    f"{pairs.touching_at_rest}, so nothing can keep them apart: {pairs.remedy}, or choose "
                    "fem.contact=off."
                )
        if np.isfinite(near_mm):
            raise InputError(
                f"fem.contact_mm is {reach_mm} mm; it must be below half of {near_mm:.3g} mm, the smallest distance "
                "between surfaces of the undeformed mesh: lower it, or choose fem.contact=off."
            )

    def _followed(self, divisions: int) -> list[Pairs]:
        """What can meet, with so many triangles along each edge."""
        surfaces = [Surface(each, self._positions, divisions, *self._law) for each in self._faces]
        plane = [MirrorPlane(surfaces, self._held, *self._law)] if self._held.any() else []
        return [*surfaces, *plane]

    def follow_more_finely(self) -> bool:
        """Twice as many triangles along each edge, or as many as can be, as before any contact; False if none can."""
        for divisions in range(min(2 * self._divisions, MOST_DIVISIONS), self._divisions, -1):
            finer = self._followed(divisions)
            if min(pairs.apart_at_rest_mm for pairs in finer) == np.inf:
                self._divisions, self._pairs, self.active = divisions, finer, self.mode == "on"
                return True
        return False

    def like(self, other: "Contact") -> "Contact":
        """The same, with as many triangles along each edge as `other` has."""
        while self._divisions < other._divisions and self.follow_more_finely():
            pass
        return self

    def carried(self, interpolation: "Callable[[Array], csr_matrix]") -> "Contact":
        """The same contact for equilibria on other nodes near one of these, see `Pairs.carried`."""
        result = copy(self)
        result._pairs = [pairs.carried(interpolation) for pairs in self._pairs]
        return result

    @cached_property
    def _seen_mm(self) -> float:
        """Distance up to which gaps are told from what is near at rest [mm]."""
        farthest = WIDEST_GAP * self.reach_mm
        return min(self._smallest_mm(self._rest, 2 * farthest) / 2, farthest)

    def response(self, displacement: Array, *, stiffness: bool) -> Response:
        """As for all terms, at a `displacement` (N, 3) [mm] without penetration."""
        return self._sum(self._pairs, displacement, stiffness)

    def sideways(self, displacement: Array) -> Response:
        """Motions that break the symmetry carry the mirror image along with the half: the gap between both stays."""
        apart = [pairs for pairs in self._pairs if not isinstance(pairs, MirrorPlane)]
        return self._sum(apart, displacement, stiffness=True)

    def _sum(self, taking_part: list[Pairs], displacement: Array, stiffness: bool) -> Response:
        first, *others = (pairs.response(displacement, stiffness=stiffness) for pairs in taking_part)
        return sum(others, start=first)

    def free_step(self, displacement: Array, correction: Array) -> float:
        """As for all terms: the part that can be added to `displacement` before surfaces meet."""
        step = min(pairs.free_step(displacement, correction) for pairs in self._pairs)
        return step if step == 1 else 0.9 * step

    def passes(self, start: Array, end: Array) -> bool:
        """Whether surfaces meet on the straight way between two displacements (N, 3) [mm]."""
        return any(pairs.passes(start, end) for pairs in self._pairs)

    def penetrates(self, displacement: Array) -> bool:
        """Whether surfaces pass through each other at `displacement` (N, 3) [mm].

        That their triangles do is seen from any depth on; of the curved faces themselves, from the reach on.
        """
        return any(pairs.penetrates(displacement) for pairs in self._pairs) or self.slips_through(displacement)

    def slips_through(self, displacement: Array) -> bool:
        """Whether curved faces pass through each other by more than the reach, though triangles may not."""
        off_mm = self._curved.off_mm(displacement, self._divisions)
        if all(pairs.gap_mm(displacement, self.reach_mm + 2 * off_mm) == np.inf for pairs in self._pairs):
            return False
        return self._curved.cross(displacement, self.reach_mm)

    def near(self, displacement: Array) -> bool:
        """Whether surfaces are within reach of each other."""
        return any(pairs.near(displacement) for pairs in self._pairs)

    def gap_mm(self, displacement: Array) -> float:
        """Smallest distance between surfaces [mm]; infinite when they are farther than half of that at rest."""
        return self._smallest_mm(displacement, self._seen_mm)

    def _smallest_mm(self, displacement: Array, farthest_mm: float) -> float:
        return min(pairs.gap_mm(displacement, farthest_mm) for pairs in self._pairs)
