"""A finger as a rod: segments with properties of their own, and the side face around the bent axis."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.face import Face
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.reduced import ReducedModel
from pgdl_lab.mechanics.rod import Axis, rod
from pgdl_lab.mechanics.segments import cuts, meet, segments

Array = NDArray[np.float64]

SHEAR_CORRECTION = 5 / 6  # of a rectangular section
FEWEST_SEGMENTS = 6  # with so many the tip is within 5 % while loads are small (benchmarks/short_fingers.py)


class FingerRod(ReducedModel):
    """A finger as a rod whose axis runs at the height of the centre of mass.

    Parameters
    ----------
    finger
        What is modelled.
    edge_mm
        Longest edge of the elements that the segments are solved with [mm].
    step_mm
        Longest element of the rod [mm].
    """

    def __init__(self, finger: ExtrudedFinger, edge_mm: float, step_mm: float) -> None:
        profile = finger.profile()
        width = np.array([0.0, finger.width_mm, 2 * finger.side_wall_mm])[profile.regions]
        part = width * np.diff(profile.z)
        area = part.sum(axis=1)  # of the material in each column
        moment = (part * (profile.z[1:] + profile.z[:-1]) / 2).sum(axis=1)

        def along(density: Array, places: Array) -> Array:
            """Integral between `places` of what the columns have per length."""
            total = np.concatenate([[0.0], np.cumsum(np.diff(profile.x) * density)])
            return np.diff(np.interp(places, profile.x, total))

        ends = profile.x[[0, -1]]
        self.axis_mm = float(along(moment, ends)[0] / along(area, ends)[0])
        self.cuts = cuts(profile)
        self.segments = segments(finger, self.cuts, edge_mm, self.axis_mm)
        pieces = np.ceil(np.diff(self.cuts) / step_mm - 1e-9).astype(int)
        self.owner = np.repeat(np.arange(len(pieces)), pieces)
        fraction = np.concatenate([np.arange(n) / n for n in pieces])
        nodes = np.append(self.cuts[self.owner] + fraction * np.diff(self.cuts)[self.owner], self.cuts[-1])

        stiffness, air = np.zeros((len(self.owner), 3, 3)), np.zeros((len(self.owner), 3))
        stiffness[:, ::2, ::2] = np.array([each.stiffness for each in self.segments])[self.owner]
        air[:, ::2] = np.array([each.air for each in self.segments])[self.owner]
        # Columns in a row add up their flexibilities in shear.
        sheared = SHEAR_CORRECTION * np.diff(self.cuts) / along(1 / area, self.cuts)
        stiffness[:, 1, 1] = finger.material.shear_modulus_mpa * sheared[self.owner]
        volume = along(area, nodes)
        mass = 1e-12 * finger.density_kg_m3 * volume
        lever = along(moment, nodes) / volume - self.axis_mm
        self.axis = Axis(nodes)
        super().__init__(finger, rod(self.axis, stiffness, air, mass, lever, finger.gravity_mm_s2[::2]))

    def observer(self, face: Face) -> Callable[[Array, float], Array]:
        """The section's rigid motion and the shapes of its segment, which are joined at the base line."""
        x, z = face.domain.points_mm.T
        height = z - self.axis_mm
        owner = np.clip(np.searchsorted(self.cuts, x) - 1, 0, len(self.segments) - 1)
        groups, ends = [], []
        for number, segment in enumerate(self.segments):
            points = np.flatnonzero(owner == number)
            length = self.cuts[number + 1] - self.cuts[number]
            groups.append(
                (points, segment.lattice.interpolation(face.domain.points_mm[points] - [self.cuts[number], 0.0]))
            )
            ends.append(segment.lattice.interpolation(np.array([[length, 0.0]])))

        def observe(state: Array, kpa: float) -> Array:
            u, w, angle = (np.interp(x, self.axis.places, component) for component in state.T)
            amplitudes = self.amplitudes(state, kpa)
            turns = np.interp(self.cuts[1:], self.axis.places, state[:, 2])
            excess, shift = np.empty_like(face.domain.points_mm), np.empty_like(face.domain.points_mm)
            reached = np.zeros(2)
            for number, (points, interpolation) in enumerate(groups):
                shape = np.tensordot(amplitudes[number], self.segments[number].shapes, 1)
                excess[points], shift[points] = interpolation @ shape, reached
                reached = reached + turn((ends[number] @ shape)[0], turns[number])
            carried = turn(excess + np.column_stack([np.zeros_like(height), height]), angle)
            return np.column_stack([u, w - height]) + carried + shift

        return observe

    def amplitudes(self, state: Array, kpa: float) -> Array:
        """Mean Γ [–] and κ [1/mm] of each segment, and the pressure [MPa]: (segments, 3)."""
        counts, strains = np.bincount(self.owner), self.axis.strains(state)[:, ::2]
        means = np.column_stack([np.bincount(self.owner, strain) / counts for strain in strains.T])
        return np.column_stack([means, np.full(len(means), 1e-3 * kpa)])

    def touches(self, state: Array, kpa: float) -> bool:
        return meet(self.segments, self.amplitudes(state, kpa))

    def doubts(self) -> list[str]:
        if len(self.segments) >= FEWEST_SEGMENTS:
            return []
        segments = "is one segment" if len(self.segments) == 1 else f"has {len(self.segments)} segments"
        return [
            f"The finger is short for fem=rod: it {segments} from gap to gap. With fewer than {FEWEST_SEGMENTS}, even "
            "under small loads, the tip is up to 35 % off, and with one by more than its whole way: choose fem=solid."
        ]

    def size(self) -> dict[str, Any]:
        return {"segments": len(self.segments), "solved_segments": len({id(each) for each in self.segments})}


def turn(vectors: Array, angle: Array | float) -> Array:
    """`vectors` (..., 2) rotated by `angle` [rad] from x to z."""
    x, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x * np.cos(angle) - z * np.sin(angle), x * np.sin(angle) + z * np.cos(angle)], axis=-1)
